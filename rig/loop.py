"""The loop at a bench: absolute deadlines on a monotonic clock, one phase after another, a safe stop at every end."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import final

from .clock import Clock
from .gate import Gate
from .histogram import Timings
from .intake import Intake, Seen
from .outcome import Outcome
from .phases.motion import SafeStop
from .phases.phase import Decision, Now, Past, Phase
from .sample import Sample, Sink
from .stop_flag import StopFlag
from .transports.reading import Reading, Transport

_S = 1e-9
_READINGS = 64  # taken at most in one sample; a flood must not cost the deadline
_PILED_UP = 100_000
_REMEMBERED = 200_000  # samples of preparation that a controller can be told of

SafeStopOf = Callable[[str, float], SafeStop]


@final
class ControlLoop:
    """Waits for a deadline, reads, decides, limits, writes, hands the sample on; never raises, never logs.

    A sample is missed when its command leaves after its end; the next one starts at once and answers without a plan.
    Samples that have passed wholly are skipped and told to the phase. The loop stops safely on a signal, a
    dead sensor, a fault of a phase, anything raised, and after standing still for longer than `stall_s`.

    Args:
        clock: time.
        transport: the device.
        intake: judge of what it measures.
        gate: hard limits.
        dt_s: sample time [s].
        sink: takes every sample.
        safe_stop: cause and velocity of the command to the phase that ends the run.
        flag: asks for a stop from outside.
        stall_s: greatest time between two samples [s].
    """

    def __init__(
        self,
        clock: Clock,
        transport: Transport,
        intake: Intake,
        gate: Gate,
        dt_s: float,
        sink: Sink,
        safe_stop: SafeStopOf,
        flag: StopFlag,
        stall_s: float = 0.5,
    ) -> None:
        self._clock, self._transport, self._intake, self._gate = clock, transport, intake, gate
        self._dt_ns, self._sink, self._safe_stop, self._flag = round(1e9 * dt_s), sink, safe_stop, flag
        self._stall_ns = round(1e9 * stall_s)
        self.timings = Timings(dt_s)
        self.faults: Counter[str] = Counter()
        self._phase: Phase | None = None
        self._rest: deque[Phase] = deque()
        self._past_u: deque[float] = deque(maxlen=_REMEMBERED)
        self._past_y: deque[float] = deque(maxlen=_REMEMBERED)
        self._start_ns = self._woke_ns = 0
        self._sequence = self._skipped = self._unsent = self._refused = 0
        self._late = False
        self._newest: Reading | None = None
        self._cause, self._stop_s, self._safe_s = "", math.nan, math.nan

    def run(self, phases: Sequence[Phase], beat_ns: int = 0) -> Outcome:
        """Go through the phases; whatever happens, the device is left at rest and the transport closed.

        Args:
            phases: what to do.
            beat_ns: monotonic time from which all deadlines are whole samples away [ns].
        """
        self._rest = deque(phases)
        self._drain()
        now = self._clock.now_ns()
        deadline = now + self._dt_ns + (beat_ns - now) % self._dt_ns
        self._start_ns = self._woke_ns = deadline - self._dt_ns
        going = True
        while going:
            self._clock.wait_until(deadline)
            going = self._sample(deadline)
            deadline = self._next(deadline)
        try:
            self._transport.stop()
        except Exception:  # noqa: BLE001 - the device is at rest; there is nobody left to tell
            self._unsent += 1
        counts = self._gate.clipped, self._unsent, self._refused
        return Outcome(self._cause, self._sequence, self._stop_s, self._safe_s, *counts, dict(self.faults))

    def _sample(self, deadline: int) -> bool:
        """One sample; False after the last one."""
        woke = self._clock.now_ns()
        seen = self._look(woke)
        now = Now(seen.angle_deg, self._gate.last, self._late, self._skipped)
        stop = self._flag.cause or seen.dead
        if stop:
            self._halt(stop, now)
        decision = self._decide(now)
        self._past_u.append(u := self._gate.admit(decision.u))
        self._past_y.append(seen.angle_deg)
        sent = self._send(u)
        done = self._clock.now_ns()
        period = woke - self._woke_ns
        self._count(period, woke - deadline, done - woke)
        self._late = done > deadline + self._dt_ns
        self.timings.missed += self._late
        faults = seen.faults if sent else (*seen.faults, "command-not-sent")
        if self._late:
            faults = (*faults, "deadline-missed")
        self.faults.update(faults)
        self._hand_on(self._record(woke, deadline, period, seen, decision, u, faults, done - woke))
        self._woke_ns = woke
        self._sequence += 1
        if not decision.finished:
            return True
        if isinstance(self._phase, SafeStop):
            self._safe_s = _S * (done - self._start_ns)
            return False
        self._phase = None
        return bool(self._rest)

    def _drain(self) -> None:
        """Throw away what has piled up before the first sample, all but the newest: it is old."""
        try:
            for _ in range(_PILED_UP):
                reading = self._transport.read()
                if reading is None:
                    return
                self._newest = reading
        except Exception:  # noqa: BLE001 - the first sample will see it again
            return

    def _look(self, woke: int) -> Seen:
        """What has arrived, judged; a transport that fails shows as a missing angle."""
        readings: list[Reading] = []
        if self._newest is not None:
            readings.append(self._newest)
            self._newest = None
        fault = ""
        try:
            while len(readings) < _READINGS and (reading := self._transport.read()) is not None:
                readings.append(reading)
        except Exception as error:  # noqa: BLE001 - a device's driver may raise anything
            fault = f"transport-{type(error).__name__}"
        seen = self._intake.judge(readings, woke, self._gate.last)
        return Seen(seen.angle_deg, (*seen.faults, fault), seen.dead) if fault else seen

    def _decide(self, now: Now) -> Decision:
        """What the present phase wants; the stop's way out where it fails."""
        for _ in range(3):
            try:
                if self._phase is None:
                    phase = self._rest.popleft()
                    phase.begin(now, Past(list(self._past_u), list(self._past_y)))
                    self._phase = phase
                decision = self._phase.step(now)
            except Exception as error:  # noqa: BLE001 - phases run foreign code; the loop must end at rest
                text = " ".join(str(error).split())[:200]
                self._halt(f"{type(error).__name__}: {text}", now)
                continue
            if not decision.fault or isinstance(self._phase, SafeStop):
                return decision
            self._halt(decision.fault, now)
        return Decision(now.held, "stop", "safe stop: held")  # out of reach: SafeStop never raises

    def _halt(self, cause: str, now: Now) -> None:
        """Turn to the safe stop, once."""
        if isinstance(self._phase, SafeStop):
            return
        self._cause, self._stop_s = cause, _S * (self._clock.now_ns() - self._start_ns)
        self._rest.clear()
        phase = self._safe_stop(cause, self._gate.velocity)
        phase.begin(now, Past([], []))
        self._phase = phase

    def _send(self, u: float) -> bool:
        try:
            self._transport.write(u)
        except Exception:  # noqa: BLE001 - counted and shown; a dead device ends the run by its silence
            self._unsent += 1
            return False
        return True

    def _hand_on(self, sample: Sample) -> None:
        try:
            self._sink.put(sample)
        except Exception:  # noqa: BLE001 - a full disk must not move the device
            self._refused += 1

    def _count(self, period: int, lateness: int, execution: int) -> None:
        if self._sequence:
            self.timings.period.add(_S * period)
        self.timings.jitter.add(_S * lateness)
        self.timings.execution.add(_S * execution)

    def _next(self, deadline: int) -> int:
        """The next deadline that has not passed by a whole sample."""
        deadline += self._dt_ns
        behind = self._clock.now_ns() - deadline
        self._skipped = max(0, behind // self._dt_ns)
        self.timings.skipped += self._skipped
        self._sequence += self._skipped
        if behind > self._stall_ns:
            self._flag.set(f"the loop stood still for {_S * behind:.2f} s")
        return deadline + self._skipped * self._dt_ns

    def _record(
        self,
        woke: int,
        deadline: int,
        period: int,
        seen: Seen,
        decision: Decision,
        u: float,
        faults: tuple[str, ...],
        execution: int,
    ) -> Sample:
        limited = not abs(u - decision.u) <= 1e-9
        return Sample(
            t_s=_S * (woke - self._start_ns),
            wall_ns=self._clock.wall_ns(),
            reference_deg=decision.reference_deg,
            measured_deg=seen.angle_deg,
            command=u,
            source=decision.source,
            status=f"{decision.status}; limited from {decision.u:.6g}" if limited else decision.status,
            predicted_deg=decision.predicted_deg,
            stages_s=(*decision.stages_s, ("execution", _S * execution)),
            period_s=_S * period,
            lateness_s=_S * max(0, woke - deadline),
            missed=self._late,
            faults=faults,
            sequence=self._sequence,
        )

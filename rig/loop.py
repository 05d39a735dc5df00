"""Control loop at a bench: absolute deadlines on a monotonic clock, a sequence of phases, a safe stop."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, final

from .axes import PerAxis, each, in_words, is_known, is_near, like
from .experiment.phases import REMEMBERED, AwaitStart, Decision, Past, Phase, PhaseInput, SafeStop, place_frames
from .histogram import Timings
from .realtime import Clock
from .recording.sample import Sample, Sink
from .safety.gate import Anchor, Gate
from .safety.intake import Intake, Observation
from .safety.stop import StopFlag, cause_of
from .transports.transport import Reading, Transport


@dataclass(frozen=True)
class RunOutcome:
    """Outcome of a run: cause of the stop, counts of samples, commands and faults.

    Times are monotonic, since the start of the run [s]; NaN without a stop, or where nothing could be sent any more.
    """

    cause: str  # of the stop; empty after a complete run
    samples: int  # with a command, and skipped ones
    stop_s: float  # of the stop
    safe_s: float  # of the safe command sent and, where `confirmed`, held
    confirmed: bool  # whether the device has reported that it holds the safe command
    clipped: int  # commands limited by the gate
    unsent: int  # commands that the transport did not take
    refused: int  # samples with an error of the sink
    faults: dict[str, int]  # samples by fault
    in_c: int = 0  # samples executed wholly in C
    left_c: dict[str, int] = field(default_factory=dict)  # returns to Python by reason


_S = 1e-9
_DISCARD_ROUNDS = 25  # batches of 4096 readings
_SLOW_NS = 300_000_000  # greatest delay of the loop by transport calls
_FAULTLESS = 5  # fault-free samples before the loop continues in C


class Times(NamedTuple):
    """Times of one sample [ns]: monotonic wake-up, deadline and end, and the wall clock."""

    woke: int
    deadline: int
    done: int
    wall: int


# Cause to the phase that leads to the safe command; no cause at the regular end.
ToSafe = Callable[[str], SafeStop]


@final
class ControlLoop:
    """Real-time loop: wait for the deadline, read, decide, limit, write, record; it never raises.

    `run` waits by its clock. A caller with a timer calls `begin` once, `sample(due())` in each period, and `outcome` at
    the end; a missed period is a sample that ended late.

    A sample is missed when its command leaves after its end; the next one starts at once, without a plan. Samples that
    have passed wholly are skipped and reported to the phase. The loop stops safely on a signal or e-stop, a dead
    sensor, a fault of a phase, a device that listens no more, and after a standstill, a time without a sent command or
    a delay by a slow wire longer than `stall_s`. Whatever any part raises is the cause of a safe stop and is in the
    log. A run ends without a cause only where the safe command has been sent.

    Nothing is sent while the held command is unknown, see `Anchor`. The transport says goodbye only where the device
    has reported that it holds the safe command.

    Args:
        to_safe: makes the last phase of every run.
        stall_s: greatest time between two samples, and between two sent commands [s].
    """

    def __init__(
        self,
        clock: Clock,
        transport: Transport,
        intake: Intake,
        gate: Gate,
        anchor: Anchor,
        dt_s: float,
        sink: Sink,
        to_safe: ToSafe,
        flag: StopFlag,
        stall_s: float = 0.5,
    ) -> None:
        self._clock, self._transport, self._intake, self._gate = clock, transport, intake, gate
        self._anchor, self._sink, self._to_safe, self._flag = anchor, sink, to_safe, flag
        self._dt_ns, self._stall_ns = round(1e9 * dt_s), round(1e9 * stall_s)
        self._reader = Reader(transport, clock, self._dt_ns)
        self.timings = Timings(dt_s)
        self.faults: Counter[str] = Counter()
        self._phase: Phase | None = None
        self._rest: deque[Phase] = deque()
        self._past_u: deque[PerAxis] = deque(maxlen=REMEMBERED)
        self._past_y: deque[PerAxis] = deque(maxlen=REMEMBERED)
        self._start_ns = self._woke_ns = self._boot_ns = self._deadline_ns = 0
        self._wire_ns = self._behind_ns = 0  # duration of transport calls, and the resulting delay
        self._discarded = 0  # readings before the first sample
        self._failures = 0  # samples that have failed
        self._sequence = self._skipped = self._waited = self._commands = self._not_sent = self._refused = 0
        self._late = False
        self._faultless = 0  # samples in a row without a fault
        self._in_c, self._left_c = 0, Counter[str]()
        self._refused_ns: int | None = None  # start of the time without a sent command
        self._newest: Reading | None = None
        self._cause, self._stop_s, self._safe_s, self._confirmed = "", math.nan, math.nan, False

    @property
    def cause(self) -> str:
        """Cause of the stop; empty without one."""
        return self._cause

    @property
    def lost(self) -> int:
        """Number of measurements that were sent and never arrived."""
        return max(0, self._intake.lost - self._discarded)

    def run(self, phases: Sequence[Phase], beat_ns: int = 0) -> RunOutcome:
        """Execute the phases, then the motion to the safe command; the transport is closed in every case.

        `beat_ns` is a monotonic time from which all deadlines are whole samples away [ns].
        """
        self.begin(phases, beat_ns)
        going = True
        while going:
            deadline = self.due()
            try:
                deadline = self._taken_in_c(deadline)
                self._clock.wait_until(deadline)
            except Exception as error:  # noqa: BLE001 - as in a sample
                self._flag.set(cause_of(error))
            going = self.sample(deadline)
        try:
            self._transport.stop(goodbye=self._confirmed)
        except Exception:  # noqa: BLE001 - the run is over, and no recipient is left
            self._not_sent += 1
        return self.outcome()

    def begin(self, phases: Sequence[Phase], beat_ns: int = 0) -> None:
        """Initialise the loop for its first sample; arguments as of `run`."""
        self._rest = deque(phases)
        self._drain()
        try:
            now, self._boot_ns = self._clock.now_ns(), self._clock.boot_ns()
        except Exception as error:  # noqa: BLE001 - as in a sample; a clock that fails for good begins nothing
            self._flag.set(cause_of(error))
            now, self._boot_ns = self._clock.now_ns(), self._clock.boot_ns()
        self._deadline_ns = now + (beat_ns - now) % self._dt_ns
        self._start_ns = self._woke_ns = self._deadline_ns

    def due(self) -> int:
        """Monotonic time of the next sample [ns]: the first deadline that is less than one sample in the past."""
        deadline = self._deadline_ns + self._dt_ns
        try:
            behind = self._clock.now_ns() - deadline
        except Exception as error:  # noqa: BLE001 - as in a sample
            self._flag.set(cause_of(error))
            return deadline
        return deadline + max(0, behind // self._dt_ns) * self._dt_ns

    def sample(self, deadline: int) -> bool:
        """Execute one sample, due at monotonic time `deadline` [ns]; return False after the last one."""
        self._advance_to(deadline)
        self._wire_ns = 0
        try:
            return self._sample(deadline)
        except Exception as error:  # noqa: BLE001 - whatever is broken, the next samples lead to the safe command
            return self._failed(cause_of(error), deadline)

    def outcome(self) -> RunOutcome:
        """Outcome of the run so far."""
        counts = self._gate.clipped, self._not_sent, self._refused
        in_c = self._in_c, dict(self._left_c)
        return RunOutcome(
            self._cause, self._sequence, self._stop_s, self._safe_s, self._confirmed, *counts, dict(self.faults), *in_c
        )

    def _taken_in_c(self, deadline: int) -> int:
        """Execute samples in C if possible; return the deadline of the next sample in Python."""
        phase = self._phase
        compiled = None if phase is None or self._faultless < _FAULTLESS or self._flag.word.value else phase.compiled()
        if phase is None or compiled is None:
            return deadline
        parts = compiled.parts(self._intake, self._gate, self._transport)
        if parts is None:
            return deadline
        self._faultless = 0
        self._advance_to(deadline)
        times = {"deadline_ns": deadline, "boot_ns": self._boot_ns, "dt_ns": self._dt_ns, "stall_ns": self._stall_ns}
        compiled.begin({**parts, **self._anchor.numbers(), **times})
        taken = phase.taken_in_c(self._flag)
        try:
            for sample, decision in taken:
                self._book(sample, compiled.received(sample), decision)
                if decision.finished:
                    self._finished()
        except Exception as error:  # noqa: BLE001 - the loop must end at rest, from the reported command
            self._flag.set(cause_of(error))
            self._anchor.not_sent(self._clock.boot_ns())
        finally:
            taken.close()  # the loop in C has ended then
        view = compiled.view
        self._left_c[compiled.reason] += 1
        self._transport.take_back(compiled.unread(), view.sent_sequence)
        self._deadline_ns = int(view.deadline_ns) - (1 + view.skipped) * self._dt_ns
        return int(view.deadline_ns)

    def _book(self, done: Any, raw: Sequence[tuple[bytes, int]], decision: Decision) -> None:
        """Check and record a sample executed in C by the rules of Python; a fault ends the loop in C."""
        self._in_c, self._wire_ns = self._in_c + 1, 0
        self._skip(done.skipped)
        readings = (self._transport.reading(*one) for one in raw)
        seen = self._intake.judge([reading for reading in readings if reading], done.woke_ns, self._gate.last)
        self._boot_ns = done.boot_ns
        self._anchor.judge(seen, done.boot_ns)
        if cause := seen.dead or self._anchor.moved or decision.fault:
            self._flag.set(cause)
        self._gate.clipped += not abs(done.u - done.answer.u) <= 1e-12
        if done.sent:
            self._command_sent(done.u, done.sent_ns)
        elif self._anchor.in_time(done.sent_boot_ns):
            self._command_refused(done.sent_boot_ns)
        else:
            self._not_sent += 1
        self._remember(self._gate.last, seen)
        faults = seen.faults if done.sent else (*seen.faults, "command-not-sent")
        times = Times(done.woke_ns, done.deadline_ns, done.done_ns, done.wall_ns)
        self._conclude(times, seen, decision, self._gate.last, faults)

    def _sample(self, deadline: int) -> bool:
        woke, boot = self._clock.now_ns(), self._clock.boot_ns()
        if boot - self._boot_ns > self._stall_ns + self._dt_ns:
            self._flag.set(f"the loop stood still for {_S * (boot - self._boot_ns):.2f} s")
        self._boot_ns = boot
        seen = self._observe()
        stop = self._flag.cause or seen.dead
        # A slow reading is as old as its check; for a command it is one more delay.
        known = self._anchor.judge(seen, boot if self._gate.anchored else self._clock.boot_ns())
        if not known:
            return self._wait(woke, deadline, seen, stop)
        skipped = self._skipped + (self._waited if self._commands else 0)
        velocity = self._gate.velocity
        held, shown = self._gate.last, (seen.frames, seen.shown_deg, seen.inputs)
        now = PhaseInput(seen.angle_deg, held, self._late, skipped, seen.held, velocity, *shown)
        if self._waited and isinstance(self._phase, SafeStop):
            self._phase.begin(now, Past([], []))  # the return motion starts at the present command
        self._waited = 0
        if stop := stop or self._anchor.moved:
            self._begin_stop(stop, now)
        if self._flag.ending and not isinstance(self._phase, SafeStop):  # the regular end: the way back is next
            self._rest.clear()
            self._phase = None
        decision = self._decide(now)
        u = self._gate.admissible(decision.u, self._clock.now_ns())
        sent = self._send(u)
        held = self._gate.last
        self._remember(held, seen)
        faults = seen.faults if sent else (*seen.faults, "command-not-sent")
        self._conclude(self._times(woke, deadline), seen, decision, held, faults)
        if not decision.finished:
            return True
        if isinstance(self._phase, SafeStop):
            self._confirmed = self._phase.confirmed
            if not self._phase.sent and not self._cause:
                self._cause = "the safe command could not be sent"
                self._stop_s = _S * (self._clock.now_ns() - self._start_ns)
            if self._cause and self._phase.sent:
                self._safe_s = _S * (self._clock.now_ns() - self._start_ns)
            return False
        self._finished()
        return True

    def _finished(self) -> None:
        """End the phase; a return motion that follows is computed in the rest of the sample."""
        self._phase = None
        if not self._rest:
            phase = self._to_safe("")
            phase.begin(PhaseInput(math.nan, self._gate.last, velocity=self._gate.velocity), Past([], []))
            self._phase = phase

    def _wait(self, woke: int, deadline: int, seen: Observation, stop: str) -> bool:
        """Send nothing in this sample while the held command is unknown; return False if the run is given up."""
        over = self._anchor.given_up or (stop if not self._commands else "")
        held = seen.held if is_known(seen.held) else self._gate.last
        if is_known(held):
            self._remember(held, seen)
        began = self._clock.now_ns()
        try:
            self._transport.greet()
        except Exception:  # noqa: BLE001 - as a command that did not leave
            self._not_sent += 1
        self._wire_ns += self._clock.now_ns() - began
        decision = Decision(held, "wait", over or "nothing is sent until it is known what the device holds")
        faults = (*seen.faults, "held-unknown") if self._commands else seen.faults
        self._conclude(self._times(woke, deadline), seen, decision, held, faults)
        self._waited += 1
        if over and not self._cause:
            self._cause, self._stop_s = stop or over, _S * (self._clock.now_ns() - self._start_ns)
        if over not in self._cause:
            self._cause = f"{self._cause}; {over}"
        return not over

    def _failed(self, cause: str, deadline: int) -> bool:
        """Record a sample in which an indispensable part has raised; return False once such samples reach `stall_s`."""
        self._flag.set(cause)
        self._failures += 1
        with suppress(Exception):  # the clock itself, or the book-keeping
            self._anchor.not_sent(self._clock.boot_ns())  # it may have left, and not be in the books
            seen, held = Observation(math.nan, ("sample-failed",), ""), self._gate.last
            times = self._times(max(self._woke_ns, deadline), deadline)
            self._conclude(times, seen, Decision(held, "wait", cause), held, seen.faults)
        if self._failures * self._dt_ns <= self._stall_ns:
            return True
        self._cause = self._cause or cause
        return False

    def _remember(self, held: PerAxis, seen: Observation) -> None:
        """Append the sample to the history for a controller that starts later."""
        if isinstance(self._phase, AwaitStart):  # the device rests: a wait of any length counts as one sample
            self._past_u.clear()
            self._past_y.clear()
        self._past_u.append(held)
        self._past_y.append(like(held, math.nan if seen.frames else seen.angle_deg))
        place_frames(self._past_y, seen.frames, _S * self._dt_ns)

    def _times(self, woke: int, deadline: int) -> Times:
        return Times(woke, deadline, self._clock.now_ns(), self._clock.wall_ns())

    def _conclude(
        self, times: Times, seen: Observation, decision: Decision, u: PerAxis, faults: tuple[str, ...]
    ) -> None:
        period = times.woke - self._woke_ns
        if self._sequence:
            self.timings.period.add(_S * period)
        self.timings.jitter.add(_S * (times.woke - times.deadline))
        self.timings.execution.add(_S * (times.done - times.woke))
        self._late = times.done > times.deadline + self._dt_ns
        self.timings.missed += self._late
        if self._late:
            faults = (*faults, "deadline-missed")
        if self._is_slow("command-not-sent" not in faults and decision.source != "wait"):
            faults = (*faults, "wire-slow")
        self.faults.update(faults)
        self._faultless = 0 if faults else self._faultless + 1
        if is_known(u):  # before the first contact there is nothing to record
            record = self._record(times, period, seen, decision, u, faults)
            try:
                self._sink.put(record)
            except Exception:  # noqa: BLE001 - a full disk must not move the device
                self._refused += 1
        self._woke_ns = times.woke
        self._sequence += 1

    def _is_slow(self, sent: bool) -> bool:
        """Whether the transport took longer than a sample; a too large accumulated delay requests a stop."""
        over, most = self._wire_ns - self._dt_ns, min(self._stall_ns, _SLOW_NS)
        if over > 0 or sent:
            self._behind_ns = max(0, self._behind_ns + min(over, most // 3))
        if self._behind_ns > most:
            self._flag.set(f"the wire is too slow: {_S * self._wire_ns:.3f} s in a sample of {_S * self._dt_ns:g} s")
        return over > 0

    def _drain(self) -> None:
        """Discard readings queued before the first sample, except the newest; for `stall_s` at most."""
        try:
            until = self._clock.now_ns() + self._stall_ns
            for _ in range(_DISCARD_ROUNDS):
                readings = self._reader.within(until - self._clock.now_ns()).readings
                if not readings:
                    return
                self._discarded += len(readings) - (self._newest is None)
                self._newest = readings[-1]
        except Exception as error:  # noqa: BLE001 - as in a sample
            self._flag.set(cause_of(error))

    def _observe(self) -> Observation:
        """Read and check measurements; a failed transport gives no angle, a failed check stops the run."""
        taken = self._reader.take(spared=bool(self._cause) and self._gate.anchored)
        self._wire_ns += taken.took_ns
        readings = taken.readings if self._newest is None else [self._newest, *taken.readings]
        self._newest = None
        faults = (taken.fault,) if taken.fault else ()
        try:
            not_listening = bool(readings) and not readings[-1].listens
            seen = self._intake.judge(readings, self._clock.now_ns(), self._gate.last)
        except Exception as error:  # noqa: BLE001 - a reading may hold anything
            self._flag.set(f"a reading cannot be judged: {cause_of(error)}")
            return Observation(math.nan, ("not-judged", *faults), "")
        if not_listening and self._commands and self._gate.anchored:
            self._flag.set("the device listens to this controller no more: its watchdog has acted, or another has it")
            return replace(seen, follows=False, faults=(*seen.faults, "not-heard", *faults))
        return replace(seen, faults=(*seen.faults, *faults)) if faults else seen

    def _decide(self, now: PhaseInput) -> Decision:
        """Decision of the present phase; that of the safe stop if the phase fails."""
        for _ in range(3):
            try:
                if self._phase is None:
                    phase = self._rest.popleft() if self._rest else self._to_safe("")
                    phase.begin(now, Past(list(self._past_u), list(self._past_y)))
                    self._phase = phase
                decision = self._phase.step(now)
                wrong, _ = decision.fault, [float(u) for u, _ in zip(each(decision.u), each(now.held), strict=True)]
            except Exception as error:  # noqa: BLE001 - phases run foreign code; the loop must end at rest
                self._begin_stop(cause_of(error), now)
                continue
            if not wrong or isinstance(self._phase, SafeStop):
                return decision
            self._begin_stop(wrong, now)
        return Decision(now.held, "stop", "safe stop: held")  # unreachable: SafeStop never raises

    def _begin_stop(self, cause: str, now: PhaseInput) -> None:
        if isinstance(self._phase, SafeStop) and self._phase.cause:
            return
        self._cause, self._stop_s = cause, _S * (self._clock.now_ns() - self._start_ns)
        self._rest.clear()
        phase = self._to_safe(cause)
        phase.begin(now, Past([], []))
        self._phase = phase

    def _send(self, u: PerAxis) -> bool:
        """Send a command; return False if it was not sent."""
        if not self._anchor.in_time(self._clock.boot_ns()):
            self._not_sent += 1
            return False
        began = self._clock.now_ns()
        try:
            self._transport.write(u)
        except Exception:  # noqa: BLE001 - counted and shown; a dead device ends the run by its silence
            self._wire_ns += self._clock.now_ns() - began
            self._command_refused(self._clock.boot_ns())
            return False
        now = self._clock.now_ns()
        self._wire_ns += now - began
        self._command_sent(u, now)
        return True

    def _command_sent(self, u: PerAxis, at: int) -> None:
        self._gate.sent(u, at)
        self._anchor.sent()
        self._commands += 1
        self._refused_ns = None

    def _command_refused(self, now: int) -> None:
        """Request a stop if the transport has accepted no command for too long."""
        self._not_sent += 1
        self._anchor.not_sent(now)
        self._refused_ns = now if self._refused_ns is None else self._refused_ns
        if now - self._refused_ns > self._stall_ns:
            self._flag.set(f"no command has left for {_S * (now - self._refused_ns):.2f} s")

    def _advance_to(self, deadline: int) -> None:
        """Set the deadline of the next sample and skip the samples that have passed wholly."""
        self._skip(max(0, (deadline - self._deadline_ns) // self._dt_ns - 1))
        self._deadline_ns = deadline

    def _skip(self, samples: int) -> None:
        self._skipped = samples
        self.timings.skipped += samples
        self._sequence += samples

    def _record(
        self, times: Times, period: int, seen: Observation, decision: Decision, u: PerAxis, faults: tuple[str, ...]
    ) -> Sample:
        limited, woke = not is_near(u, decision.u, 1e-9), times.woke
        seen_any = is_known(seen.angle_deg) or any(map(math.isfinite, each(seen.angle_deg)))
        return Sample(
            t_s=_S * (woke - self._start_ns),
            wall_ns=times.wall,
            reference_deg=decision.reference_deg,
            measured_deg=seen.angle_deg,
            command=u,
            source=decision.source,
            status=f"{decision.status}; limited from {in_words(decision.u)}" if limited else decision.status,
            predicted_deg=decision.predicted_deg,
            stages_s=(*decision.stages_s, ("execution", _S * (times.done - woke))),
            period_s=_S * period,
            lateness_s=_S * max(0, woke - times.deadline),
            missed=self._late,
            faults=faults,
            sequence=self._sequence,
            taken_s=_S * (woke - self._start_ns) - seen.age_s if seen_any else math.nan,
            inputs=seen.inputs,
        )


_SHARE = 4  # a quarter of a sample: judging may take as long once more, so half of it is left to decide and to send
_MOST = 4096  # readings, in case the clock stands still
_SPARED_NS, _SLOW_FOR_NS = 800_000_000, 3_000_000_000


class Taken(NamedTuple):
    """Readings in the order of arrival, the name of the error, and the duration of reading [ns]."""

    readings: list[Reading]
    fault: str
    took_ns: int


@final
class Reader:
    """Reader of the transport until it is empty or a quarter of a sample is over; errors are named, not raised.

    At least one call is made. A call that takes longer cannot be interrupted, and is the last one. The oldest
    reading comes first, also after such a call, so that a backlog appears as age. `dt_ns` is the sample time [ns].
    """

    def __init__(self, transport: Transport, clock: Clock, dt_ns: int) -> None:
        self._transport, self._clock, self._dt_ns = transport, clock, dt_ns
        self._slow_ns: int | None = None  # time of the last reading that took longer than a sample
        self._read_ns = 0

    def take(self, spared: bool = False) -> Taken:
        """Return the readings that have arrived.

        With `spared`, a wire whose reading lately took longer than a sample is read only every 0.8 s, so that most
        of the time remains for commands.
        """
        now = self._clock.now_ns()
        slow = self._slow_ns is not None and now - self._slow_ns < _SLOW_FOR_NS
        if spared and slow and now - self._read_ns < _SPARED_NS:
            return Taken([], "", 0)
        taken = self.within(self._dt_ns // _SHARE)
        self._read_ns = now + taken.took_ns
        if taken.took_ns > self._dt_ns:
            self._slow_ns = self._read_ns
        return taken

    def within(self, budget_ns: int) -> Taken:
        """Return the readings that can be read within a time [ns]; none for a negative time."""
        readings: list[Reading] = []
        began = now = self._clock.now_ns()
        fault = ""
        while now - began <= budget_ns and len(readings) < _MOST:
            try:
                reading = self._transport.read()
            except Exception as error:  # noqa: BLE001 - a device's driver may raise anything
                fault = f"transport-{type(error).__name__}"
                break
            if reading is None:
                break
            readings.append(reading)
            now = self._clock.now_ns()
        return Taken(readings, fault, self._clock.now_ns() - began)

"""One run on a device: transport, contact, loop, stop, latch. What is done in it is given as phases."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hystmpc.ctrl.limits import CommandLimits
from hystmpc.trials.files import write_atomically

from .anchor import Anchor
from .clock import Clock, MonotonicClock
from .config import BenchSettings
from .connect import Contact, first_contact
from .gate import Gate
from .histogram import Timings
from .intake import Intake
from .latch import RUNNING, Latch, latch_text
from .loop import ControlLoop
from .outcome import Outcome
from .phases.motion import SafeStop
from .phases.phase import Phase
from .plausibility import MotionWatch
from .ramp import ramp_commands, stop_commands
from .realtime_ import control_process
from .sample import Sink
from .signals_ import stopping_on_signals
from .stop_flag import StopFlag
from .transports.build import PlantFactory, build_transport
from .transports.reading import Transport
from .transports.units import Conversion

Note = Callable[[str], None]

_REPEATS = 5  # of the safe command
_PATIENCE_S = 1.0  # how long it is sent to a device that does not say that it holds it
_TOLERANCE = 0.01  # of the range: how far what a device says it holds may lie beside what was sent, where none is set


@dataclass(frozen=True)
class BenchResult:
    """What a run left behind.

    Attributes:
        outcome: how it ended.
        timings: period, execution, jitter, misses.
        wire: messages rejected by the transport, by cause.
        lost: measurements that were sent and never came.
        notes: what the system did not permit.
    """

    outcome: Outcome
    timings: Timings
    wire: Mapping[str, int]
    lost: int
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """Plain data for `timing.json`."""
        outcome = {k: None if v != v else v for k, v in vars(self.outcome).items()}
        wire = {"rejected": dict(self.wire), "lost": self.lost}
        return {"outcome": outcome, "wire": wire, "notes": list(self.notes), **self.timings.as_dict()}


def run_bench(
    settings: BenchSettings,
    phases: Callable[[], Sequence[Phase]],
    sink: Callable[[], Sink],
    plants: PlantFactory,
    *,
    folder: Path | None = None,
    note: Note = lambda text: None,
) -> BenchResult:
    """Prepare the device, go through the phases, and leave it at rest at the safe command.

    Args:
        settings: of the bench.
        phases: makes what comes after preparation; called once the device answers, before anything moves.
        sink: opens where samples go; called right before the loop, and closed after it.
        plants: makes the device of `kind: simulated`.
        folder: gets `timing.json`, and `latched.json` after a stop.
        note: told what goes on, outside the loop.

    Raises:
        ConfigError: if the stop is latched, the device does not answer, or settings do not fit it; nothing has moved.
    """
    clock, flag = MonotonicClock(settings.realtime.spin_s), StopFlag()
    with Latch.of(settings.name, settings.latch_file).held() as latch, stopping_on_signals(flag):
        latch.require_released()
        transport = build_transport(
            settings.transport, Conversion.of(settings.wire, settings.command_unit), settings.dt_s, clock.now_ns, plants
        )
        try:
            contact = first_contact(settings, transport, clock, flag)
            work = [*(step.phase(settings.ramps, settings.dt_s) for step in settings.prepare), *phases()]
            samples = _opened(latch, sink)
        except BaseException:
            _part(transport)
            raise
        try:
            result = _loop(settings, transport, clock, contact, flag, work, samples, note)
            _conclude(latch, result.outcome.cause)
        finally:
            _part(transport)
            samples.close()
    if folder is not None:
        _leave_files(result, folder)
    return result


def _loop(
    settings: BenchSettings,
    transport: Transport,
    clock: Clock,
    contact: Contact,
    flag: StopFlag,
    work: Sequence[Phase],
    samples: Sink,
    note: Note,
) -> BenchResult:
    ramps, dt_s, safe, sensor = settings.ramps, settings.dt_s, settings.safe_command, settings.sensor
    limits, overshoot = _limits(settings), settings.overshoot
    span = limits.upper - limits.lower
    tolerance = sensor.held_tolerance or _TOLERANCE * span

    way = partial(stop_commands, safe=safe, ramps=ramps, overshoot=overshoot, dt_s=dt_s)

    def to_safe(cause: str) -> SafeStop:
        return SafeStop(way, safe, tolerance, cause, patience=max(_REPEATS, round(_PATIENCE_S / dt_s)))

    ramp_commands(contact.held, 0.0, safe, ramps, dt_s)  # ruckig is loaded before it is needed in a hurry
    gate = Gate(limits, dt_s)
    if not contact.tells:
        gate.anchor(contact.held)
    anchor = Anchor(gate, tolerance, max(3.0 * dt_s, sensor.age_limit_s), sensor.dead_after_s)
    with control_process(settings.realtime) as notes:
        for text in notes:
            note(text)
        watch = MotionWatch(settings.plausibility, span, sensor.upper_deg - sensor.lower_deg)
        intake = Intake(sensor, clock.now_ns(), watch)
        loop = ControlLoop(
            clock, transport, intake, gate, anchor, dt_s, samples, to_safe, flag, settings.sensor.dead_after_s
        )
        outcome = loop.run(work, contact.received_ns + round(0.5e9 * dt_s))
    return BenchResult(outcome, loop.timings, dict(transport.counters), intake.lost, tuple(notes))


def _opened(latch: Latch, sink: Callable[[], Sink]) -> Sink:
    """The recording of a run that is latched: one that cannot be latched must not leave a folder."""
    latch.set(RUNNING)
    try:
        return sink()
    except BaseException:
        latch.release()
        raise


def _part(transport: Transport) -> None:
    """Close the wire without a goodbye; a driver that fails at it must not hide why the run has ended."""
    with suppress(Exception):
        transport.stop()


def _conclude(latch: Latch, cause: str) -> None:
    """Release the latch, or leave the cause in it."""
    if cause:
        latch.set(cause)
    else:
        latch.release()


def _leave_files(result: BenchResult, folder: Path) -> None:
    try:
        if result.outcome.cause:
            write_atomically(folder / "latched.json", latch_text(result.outcome.cause))
        write_atomically(folder / "timing.json", json.dumps(result.as_dict(), indent=1) + "\n")
    except Exception:  # noqa: BLE001 - a full disk must not hide how the run ended
        return


def _limits(settings: BenchSettings) -> CommandLimits:
    limits = settings.limits
    return CommandLimits(limits.lower, limits.upper, limits.rate_per_s)


def reset_latch(settings: BenchSettings) -> None:
    """Release the latch, as somebody who has looked at the device asks for.

    Raises:
        ConfigError: if another program controls the device now.
    """
    with Latch.of(settings.name, settings.latch_file).held() as latch:
        latch.release()

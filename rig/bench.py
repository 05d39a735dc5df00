"""One run on a device: transport, contact, loop, stop, latch. What is done in it is given as phases."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hystmpc.ctrl.limits import CommandLimits
from hystmpc.trials.files import write_atomically

from .clock import Clock, MonotonicClock
from .config import BenchSettings
from .connect import first_contact
from .gate import Gate
from .histogram import Timings
from .intake import Intake
from .latch import RUNNING, Latch
from .loop import ControlLoop
from .outcome import Outcome
from .phases.motion import CommandMotion, SafeStop
from .phases.phase import Phase
from .ramp import ramp_commands
from .realtime_ import control_process
from .sample import Sink
from .signals_ import stopping_on_signals
from .stop_flag import StopFlag
from .transports.build import PlantFactory, build_transport
from .transports.reading import Transport
from .transports.units import Conversion

Note = Callable[[str], None]


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
    latch = Latch.of(settings.name, settings.latch_file)
    latch.require_released()
    clock, flag = MonotonicClock(settings.realtime.spin_s), StopFlag()
    transport = build_transport(
        settings.transport, Conversion.of(settings.wire, settings.command_unit), settings.dt_s, clock.now_ns, plants
    )
    with stopping_on_signals(flag):
        try:
            contact = first_contact(settings, transport, clock, flag)
            gate = Gate(_limits(settings), settings.dt_s, contact.held)
            work = [*(step.phase(settings.ramps, settings.dt_s) for step in settings.prepare), *phases()]
            samples = _opened(latch, sink)
        except BaseException:
            _part(transport)
            raise
        try:
            result = _loop(settings, transport, clock, gate, flag, work, samples, note, contact.received_ns)
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
    gate: Gate,
    flag: StopFlag,
    work: Sequence[Phase],
    samples: Sink,
    note: Note,
    received_ns: int,
) -> BenchResult:
    ramps, dt_s, safe = settings.ramps, settings.dt_s, settings.safe_command
    back = CommandMotion("return", lambda held: ramp_commands(held, 0.0, safe, ramps, dt_s))

    def stop(cause: str, velocity: float) -> SafeStop:
        return SafeStop(lambda held: ramp_commands(held, velocity, safe, ramps, dt_s), safe, cause)

    ramp_commands(gate.last, 0.0, safe, ramps, dt_s)  # ruckig is loaded before it is needed in a hurry
    with control_process(settings.realtime) as notes:
        for text in notes:
            note(text)
        intake = Intake(settings.sensor, clock.now_ns())
        loop = ControlLoop(clock, transport, intake, gate, dt_s, samples, stop, flag, settings.sensor.dead_after_s)
        outcome = loop.run([*work, back], received_ns + round(0.5e9 * dt_s))
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
    """Close the wire; a driver that fails at it must not hide why the run has ended."""
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
            Latch(folder / "latched.json").set(result.outcome.cause)
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
    latch = Latch.of(settings.name, settings.latch_file)
    latch.require_unused()
    latch.release()

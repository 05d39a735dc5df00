"""Run on a device: first contact, control loop, safe stop, latch; the motions are given as phases."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np

from hystmpc.trials.errors import ConfigError, TrajectoryError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

from .axes import PerAxis, each, in_words, is_known, is_near, together
from .config import BenchSettings
from .experiment.phases import REPEATS, AwaitStart, Phase, SafeStop
from .histogram import Timings
from .live.desk import Desk
from .loop import ControlLoop, RunOutcome
from .realtime import Clock, MonotonicClock, control_process
from .recording.sample import Sink
from .safety.gate import Anchor, Gate
from .safety.intake import Intake
from .safety.plausibility import AxesFrame, MotionWatch, PlaneWatch, Watch
from .safety.ramp import stop_commands
from .safety.stop import RUNNING, Latch, StopFlag, latch_text, stopping_on_signals
from .transports.from_outside import PythonSettings
from .transports.transport import Conversion, PlantFactory, Reading, RunContext, Transport

_PAUSE_NS = 1_000_000

Note = Callable[[str], None]

_PATIENCE_S = 1.0  # duration of sending it to a device that does not report it
_TOLERANCE = 0.01  # default deviation of the reported from the sent command, as a share of the range


@dataclass(frozen=True)
class BenchResult:
    """Result of a run on a device."""

    outcome: RunOutcome  # how it ended
    timings: Timings  # period, execution, jitter, misses
    wire: Mapping[str, int]  # messages rejected by the transport, by cause
    lost: int  # measurements that were sent and never arrived
    notes: tuple[str, ...]  # what the system did not permit

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
    clock: Clock | None = None,
    transport: Transport | None = None,
    desk: Desk | None = None,
    frame: AxesFrame | None = None,
) -> BenchResult:
    """Prepare the device, execute the phases, and leave the device at rest at the safe command.

    Args:
        phases: makes the phases after preparation; called once the device answers, before anything moves.
        sink: opens the recording; called right before the loop, and closed after it.
        plants: makes the device of `kind: simulated`.
        folder: gets `timing.json`, and `latched.json` after a stop.
        note: called with messages, outside the loop.
        clock: of a computed device, faster than real time; the process is left as it is then.
        transport: to the device, in place of the block `transport`; called from a thread of its own.
        desk: source of start, end and e-stop requests.
        frame: coordinates of two axes in which their motion is watched; each command moves its angle where None.

    Raises:
        ConfigError: if the stop is latched, the device does not answer, or settings do not fit it; nothing has moved.
    """
    if transport is not None and len(settings.axes_limits) > 1:
        raise ConfigError(f"{settings.name}: got a transport of your own, expected udp, dds or simulated for two axes")
    if transport is not None:
        settings = settings.model_copy(update={"transport": PythonSettings.of(transport)})
    control = control_process(settings.realtime) if clock is None else nullcontext(list[str]())
    desk = desk or Desk()
    clock, flag = clock or MonotonicClock(settings.realtime.spin_s), desk.flag
    with Latch.of(settings.name, settings.latch_file).held() as latch, stopping_on_signals(flag):
        latch.require_released()
        conversion = Conversion.of(settings.wire, settings.command_unit, len(settings.axes_limits))
        wire = settings.transport.open(RunContext(conversion, settings.dt_s, clock.now_ns, plants, settings.inputs))
        try:
            contact = first_contact(settings, wire, clock, flag)
            begins: list[Phase] = [] if desk.started else [AwaitStart(lambda: desk.started)]
            work = [*begins, *(step.phase(settings.ramps, settings.dt_s) for step in settings.prepare), *phases()]
            samples = _open_latched(latch, sink)
        except BaseException:
            _close(wire)
            raise
        try:
            with control as notes:
                for text in notes:
                    note(text)
                closed = any(phase.closed_loop for phase in work)
                loop = control_loop(settings, wire, clock, contact, flag, samples, closed_loop=closed, frame=frame)
                outcome = loop.run(work, contact.newest.received_ns + round(0.5e9 * settings.dt_s))
            result = BenchResult(outcome, loop.timings, dict(wire.counters), loop.lost, tuple(notes))
            if outcome.cause:
                latch.set(outcome.cause)
            else:
                latch.release()
        finally:
            _close(wire)
            samples.close()
    if folder is not None:
        _leave_files(result, folder)
    return result


def control_loop(
    settings: BenchSettings,
    transport: Transport,
    clock: Clock,
    contact: DeviceContact,
    flag: StopFlag,
    samples: Sink,
    *,
    safe: PerAxis | None = None,
    stays: Callable[[], bool] = lambda: False,
    closed_loop: bool = False,
    frame: AxesFrame | None = None,
) -> ControlLoop:
    """Control loop of a bench with its sensor checks, motion watch and command gate: the only way to move a device.

    Args:
        safe: target of a stop, in place of the bench's `safe_command`; NaN rests where it is, see `SafeStop`.
        stays: whether the safe command is sent on once it is held.
        closed_loop: whether a controller moves the device by its angle, which then has to rise with the command.
        frame: as of `run_bench`.
    """
    ramps, dt_s, sensor = settings.ramps, settings.dt_s, settings.sensor
    limits, safe = settings.axes_limits, settings.safe_command if safe is None else safe
    span = min(one.upper - one.lower for one in limits)
    tolerance, silence_s = sensor.held_tolerance or _TOLERANCE * span, max(sensor.dead_after_s, sensor.silence_s)

    def way(held: PerAxis, velocity: PerAxis) -> Vec:
        return stop_commands(held, velocity, safe if is_known(safe) else held, ramps, settings.overshoot, dt_s)

    def to_safe(cause: str) -> SafeStop:
        flag.end()  # whoever asks for something else from now on is told so
        patience = max(REPEATS, round(_PATIENCE_S / dt_s))
        return SafeStop(way, safe, tolerance, cause, patience=patience, stays=stays)

    for velocity in (0.0, ramps.velocity_per_s, min(one.rate for one in limits)):  # once in advance, to warm up
        with suppress(TrajectoryError):
            way(contact.held, together([velocity] * len(limits)))
    gate = Gate(limits, dt_s)
    if not contact.reports_held:
        gate.anchor(contact.held)
    anchor = Anchor(gate, tolerance, max(3.0 * dt_s, sensor.age_limit_s), silence_s, safe, sensor.dead_after_s)
    watch = _motion_watch(settings, closed_loop, frame) if sensor.kind != "none" else None
    now = clock.now_ns()
    intake = Intake(sensor, now, watch, len(limits), settings.inputs)
    with suppress(Exception):  # an error here occurs in the loop again, which then stops
        intake.judge([contact.seen_at(now)], now, math.nan)
    return ControlLoop(clock, transport, intake, gate, anchor, dt_s, samples, to_safe, flag, sensor.dead_after_s)


def _motion_watch(settings: BenchSettings, closed_loop: bool, frame: AxesFrame | None) -> Watch:
    """Monitor of the motion of one axis, or of two in their coordinates."""
    sensor, spans = settings.sensor, [one.upper - one.lower for one in settings.axes_limits]
    angle_range_deg = sensor.upper_deg - sensor.lower_deg
    if len(spans) == 1:
        return MotionWatch(settings.plausibility, spans[0], angle_range_deg, closed_loop)
    frame = frame or AxesFrame(np.eye(2), np.eye(2), (spans[0], spans[1]))
    return PlaneWatch(settings.plausibility, frame, angle_range_deg, closed_loop)


def _open_latched(latch: Latch, sink: Callable[[], Sink]) -> Sink:
    """Set the latch, then open the recording, so that a run that cannot be latched leaves no folder."""
    latch.set(RUNNING)
    try:
        return sink()
    except BaseException:
        latch.release()
        raise


def _close(transport: Transport) -> None:
    """Close the transport without a goodbye; an error of its driver must not hide the end of the run."""
    with suppress(Exception):
        transport.stop()


def _leave_files(result: BenchResult, folder: Path) -> None:
    try:
        if result.outcome.cause:
            write_atomically(folder / "latched.json", latch_text(result.outcome.cause))
        write_atomically(folder / "timing.json", json.dumps(result.as_dict(), indent=1) + "\n")
    except Exception:  # noqa: BLE001 - a full disk must not hide how the run ended
        return


def reset_latch(settings: BenchSettings) -> None:
    """Release the latch of a stopped device after a person has inspected the device.

    Raises:
        ConfigError: if another program controls the device now.
    """
    with Latch.of(settings.name, settings.latch_file).held() as latch:
        latch.release()


def first_contact(settings: BenchSettings, transport: Transport, clock: Clock, flag: StopFlag) -> DeviceContact:
    """Wait until the device answers and accepts commands of this controller, without any motion.

    Raises:
        ConfigError: if no plausible angle comes in time, the device listens to another controller, the held command is
            unknown, unlike `start_command` or beyond the limits, or a signal has ended the wait.
    """
    contact, deadline = FirstContact(settings, transport), clock.now_ns() + round(1e9 * settings.connect_timeout_s)
    while True:
        if flag.cause:
            raise ConfigError(f"{settings.name}: {flag.cause} before the device answered; nothing was sent")
        if clock.now_ns() > deadline:
            raise ConfigError(contact.missing())
        try:
            reading = transport.read()
        except Exception:  # noqa: BLE001 - nobody listens yet, or a driver fails: both show as silence
            reading = None
        if reading is None:
            clock.wait_until(clock.now_ns() + _PAUSE_NS)
        elif answered := contact.judge(reading):
            return answered


_GREET_NS = 100_000_000
_ENOUGH = 3  # number of plausible angles for a first contact


@dataclass(frozen=True)
class DeviceContact:
    """State of a device that has answered: held command and newest reading."""

    held: PerAxis  # held command, as reported or by `start_command`
    newest: Reading  # the loop is timed half a sample after its receipt

    @property
    def reports_held(self) -> bool:
        """Whether the device reports its held command."""
        return is_known(self.newest.held)

    def seen_at(self, now_ns: int) -> Reading:
        """Newest reading shifted to the present, without its angle: same session, sequence and time of flight.

        Readings queued since then are therefore late, however long they waited.
        """
        later_ns, newest = now_ns - self.newest.received_ns, self.newest
        nothing = together([math.nan] * len(each(newest.angle_deg)))
        return replace(newest, angle_deg=nothing, sent_ns=newest.sent_ns + later_ns, received_ns=now_ns)


@final
class FirstContact:
    """Assessment of readings until the device has answered and listens, with a greeting ten times a second.

    `run` blocks until then; a ROS 2 node calls it in each period.
    """

    def __init__(self, settings: BenchSettings, transport: Transport) -> None:
        self._settings, self._transport = settings, transport
        self._seen, self._plausible = 0, settings.sensor.kind == "none"
        self._enough = 1 if settings.transport.in_process else _ENOUGH
        self._angle: PerAxis = math.nan
        self._listens, self._greeted_ns = True, 0

    def judge(self, reading: Reading) -> DeviceContact | None:
        """State of the device after enough plausible readings; None until then.

        Raises:
            ConfigError: if the held command is unknown, differs from `start_command`, or lies beyond the limits.
        """
        sensor = self._settings.sensor
        if sensor.kind == "continuous" or is_known(reading.angle_deg):
            self._angle = reading.angle_deg
        self._listens = reading.listens
        if not self._listens and reading.received_ns - self._greeted_ns > _GREET_NS:
            self._greeted_ns = reading.received_ns
            with suppress(Exception):
                self._transport.greet()
        inside = all(sensor.lower_deg <= angle <= sensor.upper_deg for angle in each(self._angle))
        self._plausible = self._plausible or inside
        self._seen += self._listens and (inside or sensor.kind != "continuous")
        if self._seen < self._enough or not self._plausible:
            return None
        return DeviceContact(_start(self._settings, reading.held), reading)

    def missing(self) -> str:
        """Error line for a device that has not answered as required."""
        settings, sensor = self._settings, self._settings.sensor
        if not self._listens:
            return f"{settings.name}: the device listens to another controller, expected that one to have ended"
        silent = all(map(math.isnan, each(self._angle)))
        got = "no angle" if silent else f"angle {in_words(self._angle, '.3f')} deg"
        wanted = f"expected one within {sensor.lower_deg} to {sensor.upper_deg} deg"
        if sensor.kind == "none":
            got, wanted = "nothing", "expected to be told what it holds"
        rejected = "".join(f"; {cause}, {n} times" for cause, n in self._transport.counters.items())
        return (
            f"{settings.name}: got {got} from {settings.transport.place} within {settings.connect_timeout_s:g} s"
            f"{rejected}, {wanted}; is the device on?"
        )


def _start(settings: BenchSettings, held: PerAxis) -> PerAxis:
    wanted, limits = settings.start_command, settings.axes_limits
    if not is_known(held):
        if wanted is None:
            raise ConfigError(f"{settings.name}: the device does not tell its command, expected the key start_command")
        return wanted
    span = min(one.upper - one.lower for one in limits)
    if wanted is not None and not is_near(held, wanted, 1e-3 * span):
        here, there = in_words(held), in_words(wanted)
        raise ConfigError(f"{settings.name}: the device holds command {here}, expected start_command {there}")
    inside: list[float] = []
    for value, one in zip(each(held), limits, strict=True):
        slack = 1e-9 * (one.upper - one.lower)  # rounding of a unit conversion
        if not one.lower - slack <= value <= one.upper + slack:
            raise ConfigError(
                f"start: the device holds command {value:.6g}, expected one within {one.lower} to {one.upper}; move it "
                "there by hand or correct the limits"
            )
        inside.append(min(max(value, one.lower), one.upper))
    return together(inside)

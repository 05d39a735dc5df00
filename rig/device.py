"""Simulated device behind a real wire: settings, server with a watchdog, and fault injection."""

from __future__ import annotations

import heapq
import math
import random
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TextIO, TypeVar, final, get_args

from pydantic import Field, model_validator

from hystmpc.ctrl.command import CommandLimits, LimitsSettings
from hystmpc.ctrl.loop import ContinuousSensorSettings, Imaging, ImagingSettings, Plant, SimulatedSensor
from hystmpc.trials.config import NotNegative, Positive, Settings
from hystmpc.trials.errors import ConfigError

from .axes import NAMES, InputNames, PerAxis, PlaneLimitsSettings, columns, each, from_array, is_known, spread, together
from .realtime import MonotonicClock, SchedulingSettings, scheduled
from .safety.stop import StopFlag, stopping_on_signals
from .transports.dds import DdsSettings
from .transports.simulated import InputsOf
from .transports.transport import Conversion, Datagrams, DeviceLink, Outgoing, Peer, PlaneWireUnits, WireUnits
from .transports.udp import SIZES, Datagram, Kind, UdpListenSettings, decode

_MESSAGES = 64  # greatest number in one sample
_AT_REST = 1e-3  # of the range
_LOGGED = ("received", "held", "angle_deg")  # columns of the log, behind both times


class DeviceSettings(Settings):
    """Settings of a simulated device in a separate process (`hystmpc device`).

    Attributes:
        rate_hz: samples per second.
        command_unit: of the plant.
        plant: `simulator` and effects as in a simulation file, or `device: tendon | muscle | rod`.
        sensor: the plant's angle in every message; frames of an imaging system, in messages of their own, stamped with
            the time at which they were taken; or none. A message without an angle has not-a-number in its place and
            reports the held command, in every sample.
        limits: of the drive; commands beyond are clipped and counted.
        wire: units on the wire.
        link: address of the device.
        watchdog_s: silence of the controller after which the drive returns to its rest by itself.
        watchdog_rate_per_s: how fast it returns.
        faults: faults of the wire with their times, counted from the first command.
        realtime: scheduling of the server's process.
        log: CSV file of every sample: time, command received, angle; for tests of controllers.
        seed: of noise and faults.
        inputs: measured inputs of the plant that every message has, in this order.
    """

    rate_hz: float = Field(ge=1, le=1000)
    command_unit: Literal["mm", "bar"]
    plant: dict[str, Any]
    sensor: SimulatedSensor = ContinuousSensorSettings()
    limits: LimitsSettings
    wire: WireUnits = WireUnits()
    link: Annotated[UdpListenSettings | DdsSettings, Field(discriminator="kind")]
    watchdog_s: Positive = 0.5
    watchdog_rate_per_s: Positive = 2.0
    faults: tuple[FaultSettings, ...] = ()
    realtime: SchedulingSettings = SchedulingSettings()
    log: Path | None = None
    seed: Annotated[int, Field(ge=0)] = 0
    inputs: InputNames = ()

    @model_validator(mode="after")
    def _datagrams(self) -> DeviceSettings:
        wrong = [fault for fault in self.faults if fault.of_datagrams]
        if wrong and not isinstance(self.link, UdpListenSettings):
            raise ValueError(
                f"got fault {wrong[0].fault} of {wrong[0].of} with link {self.link.kind}, expected link udp: only "
                "datagrams can be got at"
            )
        if self.inputs and not isinstance(self.link, UdpListenSettings):
            raise ValueError(f"got inputs with link {self.link.kind}, expected link udp")
        if self.axes == 1 and any(fault.axis is not None for fault in self.faults):
            raise ValueError("got a fault with the key axis, expected it for a device of two axes alone")
        return self

    @property
    def dt_s(self) -> float:
        """Sample time [s]."""
        return 1.0 / self.rate_hz

    @property
    def axes(self) -> int:
        """Number of bending axes."""
        return len(each(self.limits.build()))


class PlaneDeviceSettings(DeviceSettings):
    """Settings of a simulated device of two axes in a separate process (`hystmpc device`).

    Attributes:
        plant: a model of two axes and its changes, as `plant` in a simulation file of two axes.
        sensor: both angles in every message.
        limits: of both drives, a list each; commands beyond are clipped and counted.
        wire: units on the wire.
    """

    sensor: ContinuousSensorSettings = ContinuousSensorSettings()  # pyright: ignore[reportIncompatibleVariableOverride]
    limits: PlaneLimitsSettings  # type: ignore[assignment]  # pyright: ignore[reportIncompatibleVariableOverride]  # settings are frozen
    wire: PlaneWireUnits = PlaneWireUnits()  # pyright: ignore[reportIncompatibleVariableOverride]


@dataclass(frozen=True)
class ServerCounts:
    """Counts of a device server."""

    samples: int
    commands: int
    beyond: int  # commands beyond the drive's limits of value or rate, which were clipped
    watchdog: int  # number of silences of the controller
    unheard: int  # rejected commands between an action of the watchdog and a new greeting
    rejected: dict[str, int]  # messages rejected, by cause


def open_link(settings: DeviceSettings) -> DeviceLink:
    """Open the device's end of the wire."""

    def through(wire: Datagrams) -> Datagrams:
        return FaultyDatagrams(wire, settings.faults, settings.seed)

    faulty = any(fault.of_datagrams for fault in settings.faults)
    return settings.link.listen(settings.watchdog_s, through if faulty else None, settings.axes)


@final
class SimulatedDevice:
    """Simulated device with a drive, a watchdog and a sensor.

    The watchdog returns the drive to rest after `watchdog_s` without commands. From then on no command is accepted
    until a controller greets anew or, on a wire without greetings, until a command equals the drive's position. The
    return lasts until the first accepted command. A goodbye ends the watchdog's count, but only at rest.

    A device of two axes has a drive for each. One watchdog returns both.

    Args:
        held: the command that it holds after its reset, and returns to; of two axes a tuple.
        log: gets a line a sample: time since the start, command received (NaN for none), command applied, angle.

    Raises:
        ConfigError: if the plant's sample time is another, or it lacks a measured input of the settings.
    """

    def __init__(
        self, settings: DeviceSettings, plant: Plant, held: PerAxis, link: DeviceLink, log: TextIO | None = None
    ) -> None:
        if abs(plant.dt * settings.rate_hz - 1) > 1e-6:
            raise ConfigError(f"device: got a plant at {1 / plant.dt:g} Hz, expected rate_hz {settings.rate_hz:g}")
        self._limits: tuple[CommandLimits, ...] = each(settings.limits.build())
        self._settings, self._plant, self._link, self._log = settings, plant, link, log
        self._conversion = Conversion.of(settings.wire, settings.command_unit, settings.axes)
        self._wire = FaultyReadings(settings.faults, settings.seed)
        self._dt, self._rest, self._held, self._target = settings.dt_s, held, held, held
        self._silent, self._first = math.inf, math.nan
        self._awaits_greeting = False
        self._samples = self._commands = self._beyond = self._trips = self._unheard = 0
        self._angle, self._inputs = from_array(plant.reset()), InputsOf(plant, settings.inputs)
        sensor = settings.sensor
        self._imaging: Imaging | None = None
        if isinstance(sensor, ImagingSettings):
            self._imaging = Imaging.at_rest(sensor, settings.seed, self._angle)
        self._sent = 0

    def serve(self, flag: StopFlag, duration_s: float = math.inf) -> ServerCounts:
        """Compute and send samples until the flag is set or the duration is over."""
        clock = MonotonicClock(0.0)
        start = deadline = clock.now_ns()
        dt_ns = round(1e9 * self._dt)
        while not flag.cause and 1e-9 * (deadline - start) < duration_s:
            deadline += dt_ns
            clock.wait_until(deadline)
            behind = clock.now_ns() - deadline
            deadline += max(0, behind // dt_ns) * dt_ns  # after a stall samples are left out, not made up
            self.sample(1e-9 * (clock.now_ns() - start))
        counts = self._samples, self._commands, self._beyond, self._trips, self._unheard
        return ServerCounts(*counts, dict(self._link.counters))

    def sample(self, t_s: float) -> None:
        """Execute one sample: receive commands, move, measure, and send the readings after fault injection."""
        received = self._receive()
        if is_known(received):
            self._first = t_s if math.isnan(self._first) else self._first
        self._run_watchdog()
        drives = zip(self._limits, each(self._target), each(self._held), strict=True)
        self._held = together(limits.clip(target, held, self._dt) for limits, target, held in drives)
        self._angle = from_array(self._plant.apply(self._held))
        since = t_s - self._first if math.isfinite(self._first) else -1.0
        held, now_ns = self._conversion.raw_command(self._held), time.monotonic_ns()
        for angle, taken_s in self._measure(t_s):
            stamp_ns = now_ns - round(1e9 * (t_s - taken_s))
            raw = self._conversion.raw_angle(angle)
            inputs = tuple(self._inputs.now.values())
            self._wire.put(Outgoing(raw, held, self._sent, stamp_ns, not self._awaits_greeting, inputs), since)
            self._sent += 1
        for message in self._wire.due(since):
            self._link.send(message)
        if self._log is not None:
            values = spread(received, self._conversion.axes), each(self._held), each(self._angle)
            numbers = ",".join(repr(one) for value in values for one in value)
            self._log.write(f"{time.monotonic_ns()},{t_s:.6f},{numbers}\n")
        self._samples += 1

    def _measure(self, t_s: float) -> list[tuple[PerAxis, float]]:
        """Angles [deg] to send in this sample, at least one entry, and the times of their measurement [s]."""
        if isinstance(self._settings.sensor, ContinuousSensorSettings):
            return [(self._angle, t_s)]
        if self._imaging is None:
            return [(math.nan, t_s)]
        frames, self._imaging = self._imaging.later(t_s, self._angle)
        return [*((frame.angle_deg, frame.taken_s) for frame in frames), (math.nan, t_s)]

    def _receive(self) -> PerAxis:
        """Newest accepted command of this sample; NaN if there is none."""
        newest: PerAxis = math.nan
        for _ in range(_MESSAGES):
            message = self._link.receive()
            if message is None:
                break
            if message.says == "greeting":
                self._awaits_greeting = False
            elif message.says == "goodbye":
                self._goodbye()
            else:
                newest = self._taken(self._conversion.command(message.command), newest)
        return newest

    def _goodbye(self) -> None:
        """End the watchdog's count if the drive is at rest."""
        drives = zip(self._limits, each(self._held), each(self._rest), strict=True)
        if all(abs(held - rest) <= _AT_REST * (limits.upper - limits.lower) for limits, held, rest in drives):
            self._silent = math.inf

    def _taken(self, command: PerAxis, newest: PerAxis) -> PerAxis:
        """Set and return the target command; refuse it after a watchdog action without a new greeting."""
        drives = list(zip(self._limits, each(command), each(self._held), strict=True))
        if self._awaits_greeting and not self._link.greeted:
            self._awaits_greeting = any(abs(one - held) > limits.rate * self._dt for limits, one, held in drives)
        if self._awaits_greeting:
            self._unheard += 1
            return newest
        slacks = [1e-9 * (limits.upper - limits.lower) for limits in self._limits]
        pairs = zip(drives, slacks, strict=True)
        self._beyond += not all(limits.lower - s <= one <= limits.upper + s for (limits, one, _), s in pairs)
        self._target, self._silent = command, 0.0
        self._commands += 1
        return command

    def _run_watchdog(self) -> None:
        """Return the drive to rest after the controller has been silent for too long."""
        if math.isinf(self._silent):
            return
        self._silent += self._dt
        if self._silent <= self._settings.watchdog_s:
            return
        trips = self._silent - self._dt <= self._settings.watchdog_s
        self._trips += trips
        self._awaits_greeting = self._awaits_greeting or trips
        step = self._settings.watchdog_rate_per_s * self._dt
        drives = zip(each(self._held), each(self._rest), strict=True)
        self._target = together(held + min(max(rest - held, -step), step) for held, rest in drives)


def serve(
    settings: DeviceSettings,
    plant: Plant,
    held: PerAxis,
    ready: Callable[[DeviceLink], None],
    duration_s: float = math.inf,
    note: Callable[[str], None] = lambda text: None,
) -> ServerCounts:
    """Open the wire and serve until SIGINT, SIGTERM or for `duration_s` [s].

    Args:
        held: the command that it holds after its reset.
        ready: called once the wire is open.

    Raises:
        ConfigError: if the wire or the log cannot be opened, or the plant does not fit.
    """
    flag, link = StopFlag(), open_link(settings)
    log = None
    try:
        if settings.log is not None:
            log = _open_log(settings.log, settings.axes)
        device = SimulatedDevice(settings, plant, held, link, log)
        with stopping_on_signals(flag), scheduled(settings.realtime) as notes:
            ready(link)
            for text in notes:
                note(text)
            return device.serve(flag, duration_s)
    finally:
        link.close()
        if log is not None:
            log.close()


def _open_log(path: Path, axes: int) -> TextIO:
    of_axes = [column for name in _LOGGED for column in columns(name, math.nan, axes)]
    header = ",".join(["monotonic_ns", "time_s", *of_axes]) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        log = path.open("a+", encoding="utf-8", buffering=1)
        log.seek(0)
        begins = log.read(len(header))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{path}: cannot be written ({reason}), expected a place to log") from None
    if begins not in ("", header):
        log.close()
        raise ConfigError(f"{path}: is another kind of file, expected a device's log or a new file")
    log.write(header)
    return log


M = TypeVar("M")

_REMEMBERED = 50  # stored messages for a replay
_NS = 1e9
_STANDING = ("freeze", "blocked", "dislodged")  # faults that repeat the previous angle
_TAKEN = 64  # datagrams read from the socket in one call

Direction = Literal["readings", "commands"]
_SensorFault = Literal["freeze", "blocked", "dislodged", "nan", "outlier", "stamp_jump", "out_of_range"]
_WireFault = Literal["dropout", "delay", "jitter", "reorder", "duplicate", "replay", "corrupt"]
FaultName = Literal[_SensorFault, _WireFault]


class FaultSettings(Settings):
    """Settings of one fault of the readings, or of the commands on their way to the device.

    Attributes:
        fault: `dropout` sends nothing; `delay` sends `delay_s` late; `jitter` up to `delay_s` late; `reorder` holds a
            message back behind the next; `duplicate` sends it twice; `replay` repeats an old one; `corrupt` spoils one
            byte of a datagram. Of readings only: `freeze` repeats the last angle; `blocked` sends the last angle plus
            noise, as of a tip that cannot move; `dislodged` the same shifted by `size_deg`, as of a loose sensor;
            `nan`; `outlier` adds `size_deg` with a random sign; `stamp_jump` shifts the sender's clock by `delay_s`, of
            either sign; `out_of_range` sends 10 000 deg.
        of: direction of the affected messages.
        axis: x or y, of a fault of the angle that one of two axes has alone; null for all.
        start_s: start, counted from the first command.
        duration_s: duration.
        share: of the messages that are affected.
        size_deg: of an outlier, or of the shift of a dislodged sensor.
        noise_deg: standard deviation of the angle of a blocked tip or a dislodged sensor.
        delay_s: see `fault`.
    """

    fault: FaultName
    of: Direction = "readings"
    axis: Literal["x", "y"] | None = None
    start_s: NotNegative = 0.0
    duration_s: NotNegative = 1e9
    share: float = Field(default=1.0, gt=0, le=1)
    size_deg: NotNegative = 40.0
    noise_deg: NotNegative = 0.05
    delay_s: float = 0.2

    @model_validator(mode="after")
    def _possible(self) -> FaultSettings:
        known = get_args(_WireFault)
        if self.of == "commands" and self.fault not in known:
            raise ValueError(f"got fault {self.fault} of commands, available for them: {', '.join(known)}")
        if self.axis is not None and self.fault in (*known, "stamp_jump"):
            raise ValueError(f"got axis {self.axis} of fault {self.fault}, expected it of a fault of the angle alone")
        return self

    @property
    def of_datagrams(self) -> bool:
        """Whether the fault acts on datagrams."""
        return self.of == "commands" or self.fault == "corrupt"


@final
class FaultyLine(Generic[M]):
    """Fault injection in a stream of messages: loss, delay, repetition, reordering, changed content.

    `spoil` maps a fault and a message to the message with another content.
    """

    def __init__(
        self, faults: Sequence[FaultSettings], draws: random.Random, spoil: Callable[[FaultSettings, M], M]
    ) -> None:
        self._faults, self._random, self._spoil = tuple(faults), draws, spoil
        self._old: list[M] = []
        self._held_back: M | None = None
        self._under_way: list[tuple[float, int, M]] = []
        self._count = 0

    def active(self, t_s: float) -> list[FaultSettings]:
        """Faults that are active at `t_s` [s] after the first command."""
        return [f for f in self._faults if f.start_s <= t_s < f.start_s + f.duration_s]

    def put(self, message: M, t_s: float) -> None:
        """Add a message that is sent at `t_s` [s] after the first command."""
        copies, due = [message], t_s
        for fault in self.active(t_s):
            if self._random.random() < fault.share:
                copies = [one for message in copies for one in self._changed(fault, message)]
                due += self._late_s(fault)
        self._old = [*self._old, message][-_REMEMBERED:]
        for copy in copies:
            self._count += 1
            heapq.heappush(self._under_way, (due, self._count, copy))

    def due(self, t_s: float) -> list[M]:
        """Messages that arrive until `t_s` [s]."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= t_s:
            arrived.append(heapq.heappop(self._under_way)[2])
        return arrived

    def _late_s(self, fault: FaultSettings) -> float:
        if fault.fault == "delay":
            return abs(fault.delay_s)
        return self._random.uniform(0.0, abs(fault.delay_s)) if fault.fault == "jitter" else 0.0

    def _changed(self, fault: FaultSettings, message: M) -> list[M]:
        """Messages that replace one message under a fault."""
        name = fault.fault
        if name in ("delay", "jitter"):
            return [message]
        if name == "dropout":
            return []
        if name == "duplicate":
            return [message, message]
        if name == "replay":
            return [message, self._random.choice(self._old)] if self._old else [message]
        if name == "reorder":
            before, self._held_back = self._held_back, None if self._held_back else message
            return [message, before] if before else []
        return [self._spoil(fault, message)]


@final
class FaultyReadings:
    """Fault injection in the readings of a device."""

    def __init__(self, faults: Sequence[FaultSettings], seed: int) -> None:
        self._random, self._last = random.Random(seed), math.nan
        self._line = FaultyLine([f for f in faults if not f.of_datagrams], self._random, self._changed_content)
        self.due = self._line.due

    def put(self, message: Outgoing, t_s: float) -> None:
        """Add a reading that is measured at `t_s` [s] after the first command."""
        self._line.put(message, t_s)
        if is_known(message.angle) and not any(f.fault in _STANDING for f in self._line.active(t_s)):
            self._last = message.angle

    def _changed_content(self, fault: FaultSettings, message: Outgoing) -> Outgoing:
        if fault.fault == "stamp_jump":
            return replace(message, stamp_ns=max(0, message.stamp_ns + round(_NS * fault.delay_s)))
        angles = each(message.angle)
        pairs = zip(NAMES, angles, spread(self._last, len(angles)), strict=False)
        changed = (
            self._changed_angle(fault, angle, last) if fault.axis in (None, name) else angle
            for name, angle, last in pairs
        )
        return replace(message, angle=together(changed))

    def _changed_angle(self, fault: FaultSettings, angle: float, last: float) -> float:
        if fault.fault in ("blocked", "dislodged"):
            shift = fault.size_deg if fault.fault == "dislodged" else 0.0
            return last + shift + self._random.gauss(0.0, fault.noise_deg)
        values = {
            "freeze": last,
            "nan": math.nan,
            "outlier": angle + self._random.choice((-1.0, 1.0)) * fault.size_deg,
            "out_of_range": 1e4,
        }
        return values[fault.fault]


@final
class FaultyDatagrams:
    """Socket with fault injection: loss, delay, reordering, repetition or corruption of commands and readings.

    Time counts from the first command.
    """

    def __init__(self, wire: Datagrams, faults: Sequence[FaultSettings], seed: int) -> None:
        self._wire, self._random, self._first_ns = wire, random.Random(seed), 0
        of_commands = [f for f in faults if f.of_datagrams and f.of == "commands"]
        of_readings = [f for f in faults if f.of_datagrams and f.of == "readings"]
        self._in: FaultyLine[tuple[bytes, Peer]] = FaultyLine(
            of_commands, self._random, lambda fault, one: (self._spoilt(one[0]), one[1])
        )
        self._out: FaultyLine[bytes] = FaultyLine(of_readings, self._random, lambda fault, data: self._spoilt(data))
        self._arrived: deque[tuple[bytes, Peer]] = deque()

    def recvfrom(self, size: int) -> tuple[bytes, Peer]:
        """Oldest datagram that has arrived, and its sender; `BlockingIOError` if there is none."""
        for _ in range(_TAKEN):
            try:
                data, peer = self._wire.recvfrom(size)
            except BlockingIOError:
                break
            except ConnectionError:  # reply to an undeliverable datagram
                continue
            self._begin(data)
            self._in.put((data, peer), self._elapsed_s())
        self._arrived.extend(self._in.due(self._elapsed_s()))
        if not self._arrived:
            raise BlockingIOError
        return self._arrived.popleft()

    def sendto(self, data: bytes, peer: Peer) -> int:
        """Send a datagram after fault injection."""
        self._out.put(data, self._elapsed_s())
        for one in self._out.due(self._elapsed_s()):
            self._wire.sendto(one, peer)
        return len(data)

    def getsockname(self) -> Peer:
        """Address of this socket."""
        return self._wire.getsockname()

    def close(self) -> None:
        """Free the port."""
        self._wire.close()

    def _begin(self, data: bytes) -> None:
        axes = next((axes for axes, size in SIZES.items() if size == len(data)), 1)  # of a command, which has no inputs
        if not self._first_ns and isinstance(message := decode(data, axes), Datagram) and message.kind is Kind.COMMAND:
            self._first_ns = time.monotonic_ns()

    def _elapsed_s(self) -> float:
        return 1e-9 * (time.monotonic_ns() - self._first_ns) if self._first_ns else -1.0

    def _spoilt(self, data: bytes) -> bytes:
        spoilt, place = bytearray(data), self._random.randrange(len(data))
        spoilt[place] ^= self._random.randrange(1, 256)
        return bytes(spoilt)

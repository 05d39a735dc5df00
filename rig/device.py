"""A simulated device behind a real wire: its settings, and the server whose drive returns to rest without commands."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TextIO, final

from pydantic import Field, model_validator

from hystmpc.ctrl.command import LimitsSettings
from hystmpc.ctrl.loop import ContinuousSensorSettings, Imaging, ImagingSettings, Plant, SimulatedSensor
from hystmpc.trials.config import Positive, Settings
from hystmpc.trials.errors import ConfigError

from .realtime import MonotonicClock, SchedulingSettings, scheduled
from .safety.stop import StopFlag, stopping_on_signals
from .transports.dds import DdsSettings
from .transports.transport import Conversion, DeviceLink, Outgoing, WireUnits
from .transports.udp import UdpListenSettings
from .wire_faults import FaultSettings, FaultyDatagrams, FaultyReadings

_MESSAGES = 64  # taken at most in one sample
_AT_REST = 1e-3  # of the range
_HEADER = "monotonic_ns,time_s,received,held,angle_deg\n"  # of the log


class DeviceSettings(Settings):
    """A simulated device in a process of its own: `hystmpc device`.

    Attributes:
        rate_hz: samples per second.
        command_unit: of the plant.
        plant: `simulator` and effects as in a simulation file, or `device: tendon | muscle | rod`.
        sensor: the plant's angle in every message; frames of an imaging system, in messages of their own, stamped with
            the time at which they were taken; or none. A message without an angle has not-a-number in its place and
            says what the device holds, in every sample.
        limits: what the drive can do; commands beyond are clipped and counted.
        wire: units on the wire.
        link: how it is reached.
        watchdog_s: silence of the controller after which the drive returns to its rest by itself.
        watchdog_rate_per_s: how fast it returns.
        faults: what goes wrong, and when, counted from the first command.
        realtime: scheduling of the server's process.
        log: CSV file of every sample: time, command received, angle; for tests of controllers.
        seed: of noise and faults.
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

    @model_validator(mode="after")
    def _datagrams(self) -> DeviceSettings:
        wrong = [fault for fault in self.faults if fault.of_datagrams]
        if wrong and not isinstance(self.link, UdpListenSettings):
            raise ValueError(
                f"got fault {wrong[0].fault} of {wrong[0].of} with link {self.link.kind}, expected link udp: only "
                "datagrams can be got at"
            )
        return self

    @property
    def dt_s(self) -> float:
        """Sample time [s]."""
        return 1.0 / self.rate_hz


@dataclass(frozen=True)
class ServerCounts:
    """Counts of a device server.

    Attributes:
        samples: samples computed.
        commands: commands taken.
        beyond: commands beyond the drive's limits of value or rate, which were clipped; the rate is that over the time
            since the last command.
        watchdog: how often the controller fell silent.
        unheard: commands that came after the watchdog had acted and before a new greeting; they were not taken.
        rejected: messages rejected, by cause.
    """

    samples: int
    commands: int
    beyond: int
    watchdog: int
    unheard: int
    rejected: dict[str, int]


def open_link(settings: DeviceSettings) -> DeviceLink:
    """The device's end of the wire.

    Raises:
        ConfigError: if it cannot be opened, or a package is missing for it.
    """
    faults, seed = settings.faults, settings.seed
    faulty = any(fault.of_datagrams for fault in faults)
    return settings.link.listen(
        settings.watchdog_s, (lambda wire: FaultyDatagrams(wire, faults, seed)) if faulty else None
    )


@final
class SimulatedDevice:
    """A simulated device with a drive, a watchdog and a sensor.

    Its watchdog leads the drive back to rest once the controller has been silent for `watchdog_s`. From then on no
    command is taken until a controller greets anew; on a wire without greetings, until one lies where the drive is.
    The return goes on until the first command that is taken. A goodbye ends the watchdog's count, but only where the
    drive is at rest.

    Args:
        held: the command that it holds after its reset, and returns to.
        log: gets a line a sample: time since the start, command received (NaN for none), command applied, angle.

    Raises:
        ConfigError: if the plant's sample time is another.
    """

    def __init__(
        self, settings: DeviceSettings, plant: Plant, held: float, link: DeviceLink, log: TextIO | None = None
    ) -> None:
        if abs(plant.dt * settings.rate_hz - 1) > 1e-6:
            raise ConfigError(f"device: got a plant at {1 / plant.dt:g} Hz, expected rate_hz {settings.rate_hz:g}")
        self._limits = settings.limits.build()
        self._settings, self._plant, self._link, self._log = settings, plant, link, log
        self._conversion = Conversion.of(settings.wire, settings.command_unit)
        self._wire = FaultyReadings(settings.faults, settings.seed)
        self._dt, self._rest, self._held, self._target = settings.dt_s, held, held, held
        self._silent, self._first = math.inf, math.nan
        self._awaits_greeting = False
        self._samples = self._commands = self._beyond = self._trips = self._unheard = 0
        self._angle = plant.reset()
        sensor = settings.sensor
        self._imaging: Imaging | None = None
        if isinstance(sensor, ImagingSettings):
            self._imaging = Imaging.at_rest(sensor, settings.seed, self._angle)
        self._sent = 0

    def serve(self, flag: StopFlag, duration_s: float = math.inf) -> ServerCounts:
        """Compute and send samples until the flag is set or the time is over."""
        clock = MonotonicClock(0.0)
        start = deadline = clock.now_ns()
        dt_ns = round(1e9 * self._dt)
        while not flag.cause and 1e-9 * (deadline - start) < duration_s:
            deadline += dt_ns
            clock.wait_until(deadline)
            behind = clock.now_ns() - deadline
            deadline += max(0, behind // dt_ns) * dt_ns  # a stalled machine: samples are left out, not crowded
            self.sample(1e-9 * (clock.now_ns() - start))
        counts = self._samples, self._commands, self._beyond, self._trips, self._unheard
        return ServerCounts(*counts, dict(self._link.counters))

    def sample(self, t_s: float) -> None:
        """One sample: receive commands, move, measure, send the readings that the faults leave."""
        received = self._receive()
        if math.isfinite(received):
            self._first = t_s if math.isnan(self._first) else self._first
        self._run_watchdog()
        self._held = self._limits.clip(self._target, self._held, self._dt)
        self._angle = self._plant.apply(self._held)
        since = t_s - self._first if math.isfinite(self._first) else -1.0
        held, now_ns = self._conversion.raw_command(self._held), time.monotonic_ns()
        for angle, taken_s in self._measure(t_s):
            stamp_ns = now_ns - round(1e9 * (t_s - taken_s))
            raw = self._conversion.raw_angle(angle)
            self._wire.put(Outgoing(raw, held, self._sent, stamp_ns, not self._awaits_greeting), since)
            self._sent += 1
        for message in self._wire.due(since):
            self._link.send(message)
        if self._log is not None:
            self._log.write(f"{time.monotonic_ns()},{t_s:.6f},{received!r},{self._held!r},{self._angle!r}\n")
        self._samples += 1

    def _measure(self, t_s: float) -> list[tuple[float, float]]:
        """Angles [deg] of the messages of this sample and when they were taken [s]; one without an angle at least."""
        if isinstance(self._settings.sensor, ContinuousSensorSettings):
            return [(self._angle, t_s)]
        if self._imaging is None:
            return [(math.nan, t_s)]
        frames, self._imaging = self._imaging.later(t_s, self._angle)
        return [*((frame.angle_deg, frame.taken_s) for frame in frames), (math.nan, t_s)]

    def _receive(self) -> float:
        """The newest command of this sample that is taken, NaN where there is none."""
        newest = math.nan
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
        """The watchdog rests where the drive does; anywhere else it goes on to count, or to return."""
        if abs(self._held - self._rest) <= _AT_REST * (self._limits.upper - self._limits.lower):
            self._silent = math.inf

    def _taken(self, command: float, newest: float) -> float:
        """The command, which is the new target; `newest` where the watchdog has acted and nobody has greeted since."""
        low, high = self._limits.lower, self._limits.upper
        if self._awaits_greeting and not self._link.greeted:
            self._awaits_greeting = abs(command - self._held) > self._limits.rate * self._dt
        if self._awaits_greeting:
            self._unheard += 1
            return newest
        slack = 1e-9 * (high - low)
        self._beyond += not low - slack <= command <= high + slack
        self._target, self._silent = command, 0.0
        self._commands += 1
        return command

    def _run_watchdog(self) -> None:
        """Return to rest when the controller that moved the device has fallen silent."""
        if math.isinf(self._silent):
            return
        self._silent += self._dt
        if self._silent <= self._settings.watchdog_s:
            return
        trips = self._silent - self._dt <= self._settings.watchdog_s
        self._trips += trips
        self._awaits_greeting = self._awaits_greeting or trips
        step = self._settings.watchdog_rate_per_s * self._dt
        self._target = self._held + min(max(self._rest - self._held, -step), step)


def serve(
    settings: DeviceSettings,
    plant: Plant,
    held: float,
    ready: Callable[[DeviceLink], None],
    duration_s: float = math.inf,
    note: Callable[[str], None] = lambda text: None,
) -> ServerCounts:
    """Open the wire and serve until SIGINT, SIGTERM or the end of the time.

    Args:
        held: the command that it holds after its reset.
        ready: called once the wire is open.
        duration_s: how long at most [s].

    Raises:
        ConfigError: if the wire or the log cannot be opened, or the plant does not fit.
    """
    flag, link = StopFlag(), open_link(settings)
    log = None
    try:
        if settings.log is not None:
            log = _open_log(settings)
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


def _open_log(settings: DeviceSettings) -> TextIO:
    assert settings.log is not None
    try:
        settings.log.parent.mkdir(parents=True, exist_ok=True)
        log = settings.log.open("a+", encoding="utf-8", buffering=1)
        log.seek(0)
        begins = log.read(len(_HEADER))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{settings.log}: cannot be written ({reason}), expected a place to log") from None
    if begins not in ("", _HEADER):
        log.close()
        raise ConfigError(f"{settings.log}: is another kind of file, expected a device's log or a new file")
    log.write(_HEADER)
    return log

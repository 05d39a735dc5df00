"""First contact with a device: measurements that are required before the first command. Nothing in here waits."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import final

from hystmpc.trials.errors import ConfigError

from .config import BenchSettings
from .transports.transport import Reading, Transport

_GREET_NS = 100_000_000
_ENOUGH = 3  # plausible angles before anything is believed


@dataclass(frozen=True)
class DeviceContact:
    """State of a device that has answered: held command and newest reading."""

    held: float  # the command that it holds, as it says or as `start_command` does
    newest: Reading  # the loop keeps half a sample's distance from its receipt, and goes by its time of flight

    @property
    def reports_held(self) -> bool:
        """Whether the device reports the command that it holds."""
        return math.isfinite(self.newest.held)

    def seen_at(self, now_ns: int) -> Reading:
        """The newest reading moved to the present, without its angle: same session, sequence and time of flight.

        What has piled up since then is late by these, however long it lay.
        """
        later_ns, newest = now_ns - self.newest.received_ns, self.newest
        return replace(newest, angle_deg=math.nan, sent_ns=newest.sent_ns + later_ns, received_ns=now_ns)


@final
class FirstContact:
    """Judges readings one by one until the device has answered and listens; meanwhile it is greeted ten times a second.

    A bench waits for it, and a node asks in each period.
    """

    def __init__(self, settings: BenchSettings, transport: Transport) -> None:
        self._settings, self._transport = settings, transport
        self._seen, self._plausible = 0, settings.sensor.kind == "none"
        self._enough = 1 if settings.transport.in_process else _ENOUGH
        self._angle, self._listens, self._greeted_ns = math.nan, True, 0

    def judge(self, reading: Reading) -> DeviceContact | None:
        """State of the device after enough plausible readings, None until then.

        Raises:
            ConfigError: if device and `start_command` disagree, neither tells what is held, or that is beyond the
                limits.
        """
        sensor = self._settings.sensor
        if sensor.kind == "continuous" or math.isfinite(reading.angle_deg):
            self._angle = reading.angle_deg
        self._listens = reading.listens
        if not self._listens and reading.received_ns - self._greeted_ns > _GREET_NS:
            self._greeted_ns = reading.received_ns
            with suppress(Exception):
                self._transport.greet()
        inside = sensor.lower_deg <= self._angle <= sensor.upper_deg
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
        got = "no angle" if math.isnan(self._angle) else f"angle {self._angle:.3f} deg"
        wanted = f"expected one within {sensor.lower_deg} to {sensor.upper_deg} deg"
        if sensor.kind == "none":
            got, wanted = "nothing", "expected to be told what it holds"
        rejected = "".join(f"; {cause}, {n} times" for cause, n in self._transport.counters.items())
        return (
            f"{settings.name}: got {got} from {settings.transport.place} within {settings.connect_timeout_s:g} s"
            f"{rejected}, {wanted}; is the device on?"
        )


def _start(settings: BenchSettings, held: float) -> float:
    wanted = settings.start_command
    if not math.isfinite(held):
        if wanted is None:
            raise ConfigError(f"{settings.name}: the device does not tell its command, expected the key start_command")
        return wanted
    if wanted is not None and abs(held - wanted) > 1e-3 * (settings.limits.upper - settings.limits.lower):
        raise ConfigError(f"{settings.name}: the device holds command {held:.6g}, expected start_command {wanted:.6g}")
    low, high = settings.limits.lower, settings.limits.upper
    slack = 1e-9 * (high - low)  # of a conversion of units
    if not low - slack <= held <= high + slack:
        raise ConfigError(
            f"start: the device holds command {held:.6g}, expected one within {low} to {high}; move it there by hand "
            "or correct the limits"
        )
    return min(max(held, low), high)

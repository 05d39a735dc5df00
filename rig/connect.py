"""The first contact with a device: wait for an angle, and for the command that it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hystmpc.trials.errors import ConfigError

from .clock import Clock
from .config import BenchSettings
from .stop_flag import StopFlag
from .transports.reading import Transport
from .transports.settings import DdsSettings, TransportSettings, UdpSettings

_PAUSE_NS = 1_000_000
_GREET_NS = 100_000_000
_ENOUGH = 3  # plausible angles before anything is believed


@dataclass(frozen=True)
class Contact:
    """What is known of a device that has answered.

    Attributes:
        held: the command that it holds, as it says or as `start_command` does.
        tells: whether it says so itself.
        received_ns: monotonic time at which its last angle came [ns]; the loop keeps half a sample's distance.
    """

    held: float
    tells: bool
    received_ns: int


def first_contact(settings: BenchSettings, transport: Transport, clock: Clock, flag: StopFlag) -> Contact:
    """Wait until the device answers and listens to this controller; it is not moved.

    Raises:
        ConfigError: if no plausible angle comes in time, the device listens to another controller, device and
            `start_command` disagree, neither tells what is held, that is beyond the limits, or a signal has ended the
            wait.
    """
    sensor, held, seen, angle, received = settings.sensor, math.nan, 0, math.nan, clock.now_ns()
    enough = 1 if settings.transport.kind in ("simulated", "replay") else _ENOUGH
    deadline = clock.now_ns() + round(1e9 * settings.connect_timeout_s)
    listens, greeted = True, 0
    while seen < enough:
        if flag.cause:
            raise ConfigError(f"{settings.name}: {flag.cause} before the device answered; nothing was sent")
        if clock.now_ns() > deadline:
            if not listens:
                raise ConfigError(
                    f"{settings.name}: the device listens to another controller, expected that one to have ended"
                )
            got = "no angle" if math.isnan(angle) else f"angle {angle:.3f} deg"
            rejected = "".join(f"; {cause}, {n} times" for cause, n in transport.counters.items())
            raise ConfigError(
                f"{settings.name}: got {got} from {_where(settings.transport)} within {settings.connect_timeout_s:g} s"
                f"{rejected}, expected one within {sensor.lower_deg} to {sensor.upper_deg} deg; is the device on?"
            )
        try:
            reading = transport.read()
        except OSError:  # nobody listens yet
            reading = None
        if reading is None:
            clock.wait_until(clock.now_ns() + _PAUSE_NS)
            continue
        angle, held, received, listens = reading.angle_deg, reading.held, reading.received_ns, reading.listens
        if not listens and received - greeted > _GREET_NS:
            greeted = received
            transport.greet()
        seen += listens and sensor.lower_deg <= angle <= sensor.upper_deg
    return Contact(_start(settings, held), math.isfinite(held), received)


def _where(transport: TransportSettings) -> str:
    if isinstance(transport, UdpSettings):
        return f"udp {transport.host} port {transport.port}"
    if isinstance(transport, DdsSettings):
        return f"dds topic {transport.angle_topic} in domain {transport.domain}"
    return transport.kind


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

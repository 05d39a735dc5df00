"""The device's end of a wire."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A measurement on its way: raw angle and held command in the wire's units, sequence, sender's clock [ns]."""

    angle: float
    held: float
    sequence: int
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class Incoming:
    """What a controller says: a raw command, or that it has stopped (then `command` is NaN)."""

    command: float
    stopped: bool = False


class DeviceLink(Protocol):
    """What a device server talks through. Nothing blocks."""

    def receive(self) -> Incoming | None:
        """The oldest message not yet taken, None where there is none."""
        ...

    def send(self, message: Outgoing) -> None:
        """Send a measurement to whoever controls; to nobody where there is none."""
        ...

    def close(self) -> None:
        """Free the wire."""
        ...

    @property
    def counters(self) -> Mapping[str, int]:
        """What was rejected, by cause."""
        ...

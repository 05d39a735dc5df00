"""The device's end of a wire."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A measurement on its way.

    Attributes:
        angle, held: raw angle and held command in the wire's units.
        sequence: rises by one a measurement.
        stamp_ns: sender's clock [ns].
        listens: whether commands are taken now, or a new greeting is wanted first.
    """

    angle: float
    held: float
    sequence: int
    stamp_ns: int
    listens: bool = True


Says = Literal["command", "greeting", "goodbye"]


@dataclass(frozen=True, slots=True)
class Incoming:
    """What the controller that is listened to says; `command` is the raw one, NaN unless it says one."""

    command: float = math.nan
    says: Says = "command"


class DeviceLink(Protocol):
    """What a device server talks through. Nothing blocks."""

    greeted: bool
    """Whether controllers greet on this wire: without sessions they cannot."""

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

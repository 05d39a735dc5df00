"""What a transport is: the only thing that a new device has to bring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Reading:
    """One measurement as it arrived, not yet judged; angles in degrees, commands in the run's unit.

    Attributes:
        angle_deg: measured tip angle, possibly not a number [deg].
        sequence: the sender's count, rising by one a measurement.
        session: chosen by the sender at its start; another one means that it has been restarted.
        sent_ns: the sender's monotonic clock, of any origin [ns].
        received_ns: this process's monotonic clock at receipt [ns].
        held: the command that the device holds; NaN where it does not tell.
    """

    angle_deg: float
    sequence: int
    session: int
    sent_ns: int
    received_ns: int
    held: float


class Transport(Protocol):
    """The wire to a device. Nothing blocks for longer than a system call; what fails raises `OSError`."""

    def read(self) -> Reading | None:
        """The oldest measurement that has not been read yet, None where there is none."""
        ...

    def write(self, command: float) -> None:
        """Send a command, in the run's unit."""
        ...

    def stop(self) -> None:
        """Tell the device that nobody will command it any more, and close; may be called twice."""
        ...

    @property
    def counters(self) -> Mapping[str, int]:
        """What was rejected on the wire, by cause."""
        ...

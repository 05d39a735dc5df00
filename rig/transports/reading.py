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
        listens: whether the device takes commands of this session; True where it does not tell.
    """

    angle_deg: float
    sequence: int
    session: int
    sent_ns: int
    received_ns: int
    held: float
    listens: bool = True


class Transport(Protocol):
    """The wire to a device. Nothing blocks for longer than a system call; what fails raises `OSError`."""

    def read(self) -> Reading | None:
        """The oldest measurement that has not been read yet, None where there is none."""
        ...

    def write(self, command: float) -> None:
        """Send a command, in the run's unit."""
        ...

    def greet(self) -> None:
        """Ask the device to take commands of this session, again after its watchdog has acted; nothing is moved."""
        ...

    def stop(self, goodbye: bool = False) -> None:
        """Close; may be called twice.

        Args:
            goodbye: whether to tell the device that nobody will command it any more, so that its watchdog may rest.
                Only for a device that has said that it holds the safe command.
        """
        ...

    @property
    def counters(self) -> Mapping[str, int]:
        """What was rejected on the wire, by cause."""
        ...

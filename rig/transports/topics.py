"""Two topics, one of angles and one of commands: settings, and the controller's end.

The wire is that of Cyclone DDS (`dds_`) or of a ROS 2 node.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, Self, final

from pydantic import Field

from hystmpc.trials.config import Count, Settings

from ..axes import PerAxis, each, together
from .transport import Conversion, Reading, Transport, TransportBase

_NS = 1_000_000_000
# What a controller says by frame_id beside commands; a device says there which session it listens to.
GREETING, GOODBYE = "greeting", "goodbye"
_LISTENS = "listens:"
WRONG_SIZE = "wrong size"
"""Why a message is refused that has not one number for each axis."""


def listening(session: int | None) -> str:
    """Text by which a device reports the session that it listens to, or none."""
    return f"{_LISTENS}none" if session is None else f"{_LISTENS}{session:08x}"


def unknown(axes: int) -> PerAxis:
    """Not-a-number of every axis."""
    return together([math.nan] * axes)


def numbers(data: Any) -> PerAxis:
    """Numbers of a message: one of one axis as it is, the array of several as a tuple."""
    return data if isinstance(data, float) else together(map(float, data))


def stamp(wall_ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds of a time [ns]."""
    return wall_ns // _NS, wall_ns % _NS


class QosSettings(Settings):
    """Quality of service of both topics, in the words of ROS 2.

    Attributes:
        reliability: whether a lost message is sent again.
        durability: whether a late reader gets the last messages.
        depth: messages that are kept.
    """

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: Count = 10


class TopicSettings(TransportBase):
    """Names, message, domain and quality of service of both topics, explained in `DdsSettings`."""

    kind: Literal["dds"]
    angle_topic: str = "tip/angle_deg"
    command_topic: str = "tip/command"
    message: Literal["float64", "float64_stamped"] = "float64_stamped"
    domain: int = Field(default=0, ge=0, le=232)
    qos: QosSettings = QosSettings()
    interface: str | None = None

    @property
    def place(self) -> str:
        return f"dds topic {self.angle_topic} in domain {self.domain}"


@dataclass(frozen=True, slots=True)
class TopicMessage:
    """Message of a measurement on its topic."""

    data: PerAxis  # raw angle; of two axes both
    sequence: int  # the sender's count
    sent_ns: int  # the sender's clock [ns]
    session: int = 0  # of the sender; 0 without one
    held: PerAxis = math.nan  # raw command that the device holds; NaN where it does not report
    note: str = ""  # `frame_id`, empty without one

    @classmethod
    def of(cls, stamped: Any) -> Self:
        """Message from a hystmpc_msgs/msg/Float64Stamped or Float64PairStamped of any binding."""
        header, data, held = stamped.header, numbers(stamped.data), numbers(stamped.held)
        sent = header.stamp.sec * _NS + header.stamp.nanosec
        return cls(data, stamped.sequence, sent, stamped.session, held, header.frame_id)


class TopicWire(Protocol):
    """Writer of one topic and reader of another; no method blocks."""

    @property
    def session(self) -> int:
        """Session of this end, chosen at random."""
        ...

    def read(self) -> TopicMessage | None:
        """Oldest unread message, None if there is none."""
        ...

    def write(self, value: PerAxis, held: PerAxis, *, note: str = "") -> None:
        """Send a number, or one of each axis, with the sequence and stamp of the wire."""
        ...

    def close(self) -> None:
        """Leave both topics."""
        ...


@final
class TopicTransport(Transport):
    """Transport that reads the angle topic and writes the command topic.

    A message without a stamp carries neither sequence nor session: a restarted device is not noticed.

    Args:
        now_ns: monotonic clock [ns].
    """

    def __init__(self, wire: TopicWire, conversion: Conversion, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._wire: TopicWire | None = wire
        self._now = now_ns
        self._conversion, self._listens = conversion, listening(wire.session)
        self._nothing, self._zero = unknown(conversion.axes), together([0.0] * conversion.axes)
        self._device_has_sessions = False
        self._counters: Counter[str] = Counter()

    @property
    def counters(self) -> Mapping[str, int]:
        return self._counters

    def read(self) -> Reading | None:
        while (message := None if self._wire is None else self._wire.read()) is not None:
            if len(each(message.data)) == self._conversion.axes:
                return self._reading(message)
            self._counters[WRONG_SIZE] += 1
        return None

    def _reading(self, message: TopicMessage) -> Reading:
        now, angle = self._now(), self._conversion.angle_deg(message.data)
        self._device_has_sessions = message.note.startswith(_LISTENS)
        listens = not self._device_has_sessions or message.note == self._listens
        held = self._conversion.command(message.held)
        return Reading(angle, message.sequence, message.session, message.sent_ns, now, held, listens)

    def write(self, command: PerAxis) -> None:
        if self._wire is not None:
            self._wire.write(self._conversion.raw_command(command), self._zero)

    def greet(self) -> None:
        """Ask the device to listen; no message without sessions, where it would count as a command."""
        if self._wire is not None and self._device_has_sessions:
            self._wire.write(self._nothing, self._zero, note=GREETING)

    def stop(self, goodbye: bool = False) -> None:
        """Leave the topics, after a goodbye if it is wanted and the device has sessions."""
        wire, self._wire = self._wire, None
        if wire is not None:
            if goodbye and self._device_has_sessions:
                wire.write(self._nothing, self._zero, note=GOODBYE)
                time.sleep(0.02)  # the last message leaves before the writer does
            wire.close()

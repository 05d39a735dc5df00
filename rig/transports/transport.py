"""Interfaces of transports and of the device end, conversion of units, sessions and sequence numbers."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Protocol, Self, final

from hystmpc.ctrl.loop import Plant
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError

from ..axes import PerAxis, each, together

NO_INPUTS: Mapping[str, Any] = MappingProxyType({})
"""Values of the measured inputs of a device that has none."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One measurement as received, before any check; angles in degrees, commands in the run's unit.

    Attributes:
        angle_deg: measured tip angle, possibly not a number [deg]; of two axes both, as `held`.
        sequence: the sender's count, rising by one a measurement.
        session: chosen by the sender at its start; a new one means a restart.
        sent_ns: the sender's monotonic clock, of any origin [ns].
        received_ns: this process's monotonic clock at receipt [ns].
        held: the command that the device holds; NaN where it does not report.
        listens: whether the device takes commands of this session; True where it does not report.
        inputs: values of measured inputs by name; not-a-number, or left out, where there is none.
    """

    angle_deg: PerAxis
    sequence: int
    session: int
    sent_ns: int
    received_ns: int
    held: PerAxis
    listens: bool = True
    inputs: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def now(
        cls, angle_deg: float, sequence: int, held: float = math.nan, inputs: Mapping[str, float] = NO_INPUTS
    ) -> Reading:
        """Measurement received just now from a device without sessions and stamps.

        Args:
            angle_deg: measured angle, in the unit of the block `wire` [deg].
            sequence: rises by one a measurement.
            held: command that the device holds; NaN where it does not report.
            inputs: as of a reading.
        """
        now_ns = time.monotonic_ns()
        return cls(angle_deg, sequence, 0, now_ns, now_ns, held, inputs=inputs)


class Transport(Protocol):
    """Interface of a transport to a device. No method blocks for longer than a system call; failures raise `OSError`.

    A transport from outside the package may use other units, see `GuardedTransport`.
    """

    def read(self) -> Reading | None:
        """Oldest unread measurement, None if there is none."""
        ...

    def write(self, command: PerAxis) -> None:
        """Send a command, in the run's unit; of two axes both at once."""
        ...

    def greet(self) -> None:
        """Ask the device to accept commands of this session, repeated after its watchdog has acted; nothing moves."""
        ...

    def stop(self, goodbye: bool = False) -> None:
        """Close the transport; a second call is allowed.

        With `goodbye`, the device is informed that nobody will command it any more, so that its watchdog may rest: only
        for a device that has reported that it holds the safe command.
        """
        ...

    @property
    def counters(self) -> Mapping[str, int]:
        """Number of rejected messages by cause."""
        ...

    def numbers(self) -> Mapping[str, float] | None:
        """Data for reading and writing by a loop in C; None for a transport without C."""
        return None

    def reading(self, data: bytes, received_ns: int) -> Reading | None:
        """Decode a reading received by the loop in C; None for an invalid one."""
        del data, received_ns
        return None

    def take_back(self, unread: Sequence[tuple[bytes, int]], sent: int) -> None:
        """Resume after a loop in C: its unused messages (bytes, receipt time [ns]) are read first.

        `sent` is the sequence number of its last message.
        """
        del unread, sent


@dataclass(frozen=True, slots=True)
class Outgoing:
    """Measurement sent by a device: raw angle and held command in the wire's units."""

    angle: PerAxis
    held: PerAxis
    sequence: int  # rises by one a measurement
    stamp_ns: int  # sender's clock [ns]
    listens: bool = True  # whether commands are taken now, or a new greeting is needed first
    inputs: tuple[float, ...] = ()  # values of measured inputs, in the order of the settings


Says = Literal["command", "greeting", "goodbye"]


@dataclass(frozen=True, slots=True)
class Incoming:
    """Message of the admitted controller; `command` is in the wire's unit, NaN for other messages."""

    command: PerAxis = math.nan
    says: Says = "command"


class DeviceLink(Protocol):
    """Interface of the device's end of a wire; no method blocks."""

    greeted: bool
    """Whether controllers greet on this wire: without sessions they cannot."""

    def receive(self) -> Incoming | None:
        """Oldest unread message, None if there is none."""
        ...

    def send(self, message: Outgoing) -> None:
        """Send a measurement to the controller in charge, if there is one."""
        ...

    def close(self) -> None:
        """Release the wire."""
        ...

    @property
    def counters(self) -> Mapping[str, int]:
        """Number of rejected messages by cause."""
        ...


AngleUnit = Literal["deg", "rad"]
CommandUnit = Literal["mm", "m", "bar", "kPa", "Pa"]

_TO_DEG = {"deg": 1.0, "rad": 180.0 / math.pi}
_TO_RUN = {"mm": ("mm", 1.0), "m": ("mm", 1e3), "bar": ("bar", 1.0), "kPa": ("bar", 1e-2), "Pa": ("bar", 1e-5)}


class WireUnits(Settings):
    """Block `wire`: units of the device; angle [deg] = sign * raw + offset_deg, with raw converted to degrees.

    Attributes:
        angle_unit: unit of the angle on the wire.
        angle_sign: -1 where the device counts the other way.
        angle_offset_deg: added to the angle [deg].
        command_unit: unit of the command on the wire; null for that of the bench.
    """

    angle_unit: AngleUnit = "deg"
    angle_sign: Literal[1, -1] = 1
    angle_offset_deg: float = 0.0
    command_unit: CommandUnit | None = None


Sign = Literal[1, -1]


class PlaneWireUnits(WireUnits):
    """Block `wire` of two axes: sign and offset are those of both angles, or a list `[x, y]`.

    Attributes:
        angle_sign: -1 where the device counts the other way; of both angles, or of each.
        angle_offset_deg: added to the angle; to both, or to each [deg].
    """

    angle_sign: Sign | tuple[Sign, Sign] = 1  # type: ignore[assignment]  # pyright: ignore[reportIncompatibleVariableOverride]  # settings are frozen
    angle_offset_deg: float | tuple[float, float] = 0.0  # type: ignore[assignment]  # pyright: ignore[reportIncompatibleVariableOverride]


@dataclass(frozen=True)
class Conversion:
    """Conversion of raw numbers of the wire to degrees and the run's command unit, and back; of each axis."""

    angle_factor: PerAxis
    angle_offset_deg: PerAxis
    command_factor: float

    @classmethod
    def of(cls, wire: WireUnits, command_unit: str, axes: int = 1) -> Conversion:
        """Conversion between a wire and a run of one axis or of two.

        Raises:
            ConfigError: if one speaks of travel and the other of pressure.
        """
        unit, factor = _TO_RUN[wire.command_unit or command_unit]
        if unit != command_unit:
            raise ConfigError(
                f"wire: got command_unit {wire.command_unit}, expected a unit of the run's {command_unit}"
            )
        signs, offsets = (
            value if isinstance(value, tuple) else (value,) * axes for value in (wire.angle_sign, wire.angle_offset_deg)
        )
        return cls(together(sign * _TO_DEG[wire.angle_unit] for sign in signs), together(offsets), factor)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(each(self.angle_factor))

    def angle_deg(self, raw: PerAxis) -> PerAxis:
        """Angle [deg] of a raw angle."""
        parts = zip(each(self.angle_factor), each(raw), each(self.angle_offset_deg), strict=True)
        return together(factor * one + offset for factor, one, offset in parts)

    def raw_angle(self, angle_deg: PerAxis) -> PerAxis:
        """Raw number of an angle [deg]."""
        parts = zip(each(angle_deg), each(self.angle_offset_deg), each(self.angle_factor), strict=True)
        return together((one - offset) / factor for one, offset, factor in parts)

    def command(self, raw: PerAxis) -> PerAxis:
        """Command in the run's unit of a raw command."""
        return together(self.command_factor * one for one in each(raw))

    def raw_command(self, command: PerAxis) -> PerAxis:
        """Raw number of a command in the run's unit."""
        return together(one / self.command_factor for one in each(command))


Peer = tuple[str, int]


class Datagrams(Protocol):
    """Interface of a datagram socket, in front of which faults can be injected."""

    def recvfrom(self, size: int, /) -> tuple[bytes, Any]:
        """Oldest datagram and its sender; `BlockingIOError` if there is none."""
        ...

    def sendto(self, data: bytes, peer: Peer, /) -> int:
        """Send a datagram."""
        ...

    def getsockname(self) -> Any:
        """Address of this socket."""
        ...

    def close(self) -> None:
        """Release the port."""
        ...


# Puts faults before a socket.
SocketWrapper = Callable[[Datagrams], Datagrams]

# Makes the device of `kind: simulated`: its settings and the sample time to a plant and the command that it holds.
# Given by the program, since this room knows no simulator.
PlantFactory = Callable[[Any, float], tuple[Plant, PerAxis]]


@dataclass(frozen=True)
class RunContext:
    """Context of a run for the opening of a transport."""

    conversion: Conversion  # of the wire's units
    dt_s: float  # sample time of the loop [s]
    now_ns: Callable[[], int]  # monotonic clock
    plants: PlantFactory  # makes simulated devices
    inputs: tuple[str, ...] = ()  # names of the measured inputs of a reading, in their order


class TransportBase(Settings):
    """Base class of transport settings."""

    in_process: ClassVar[bool] = False  # the device answers at once, from this process

    @property
    @abstractmethod
    def place(self) -> str:
        """Location of the device, for messages."""

    def resolved(self, folder: Path) -> Self:
        """Same settings with file names resolved against `folder`."""
        del folder
        return self

    @abstractmethod
    def open(self, run: RunContext) -> Transport:
        """Open the transport.

        Raises:
            ConfigError: if the wire cannot be opened, or a package is missing for it.
            LogError: if a run to replay cannot be read.
        """


NEW, RESTARTED, REPLAYED = "", "restarted", "replayed-or-reordered"
_HALF = 1 << 31
_REMEMBERED = 64  # sessions that have ended; what claims to come from one of them is a replay


@final
class Order:
    """Detector of repeated, reordered and replayed messages; sequence numbers wrap at 2^32."""

    def __init__(self) -> None:
        self._session: int | None = None
        self._sequence = 0
        self._ended: list[int] = []
        self.lost = 0

    def numbers(self) -> Mapping[str, int]:
        """Session and sequence number of the newest message."""
        return {"session": self._session or 0, "sequence": self._sequence}

    def judge(self, session: int, sequence: int) -> str:
        """Classify a message as `NEW`, `RESTARTED` (new as well) or `REPLAYED`; count missing messages in `lost`."""
        if session == self._session:
            ahead = (sequence - self._sequence) & 0xFFFFFFFF
            if not 0 < ahead < _HALF:
                return REPLAYED
            self.lost += ahead - 1
            self._sequence = sequence
            return NEW
        if session in self._ended:
            return REPLAYED
        first = self._session is None
        if self._session is not None:
            self._ended = [*self._ended, self._session][-_REMEMBERED:]
        self._session, self._sequence = session, sequence
        return NEW if first else RESTARTED


ANOTHER, NO_GREETING, OLD = "another controller", "no greeting", "replayed-or-reordered"


@final
class Admission:
    """Exclusive access of one controller: a greeting opens its session, a goodbye or a silence ends it.

    After a silence of `silence_s` [s] another greeting ends the session. Messages of others are refused meanwhile and
    change nothing. A session that has ended is not resumed.
    """

    def __init__(self, silence_s: float) -> None:
        self._silence_ns = round(1e9 * silence_s)
        self._order = Order()
        self._pinned: tuple[object, int] | None = None
        self._heard_ns = 0
        self._commanded = False

    @property
    def session(self) -> int | None:
        """Session in charge."""
        return None if self._pinned is None else self._pinned[1]

    def admit(self, says: Says, sender: object, session: int, sequence: int, now_ns: int) -> str:
        """Reason for refusing a message, empty if it is admitted.

        The goodbye of a session that has never commanded ends the session and is refused. `sender` is an address, or
        the writer of a topic.
        """
        known = self._pinned == (sender, session)
        if says == "greeting":
            if not known and self._pinned is not None and now_ns - self._heard_ns <= self._silence_ns:
                return ANOTHER
        elif self._pinned is None:
            return NO_GREETING
        elif not known:
            return ANOTHER
        if self._order.judge(session, sequence) not in (NEW, RESTARTED):
            return OLD
        self._heard_ns = now_ns
        if says == "goodbye":
            self._pinned = None
            return "" if self._commanded else "goodbye without a command"
        if says == "command":
            self._commanded = True
        if says == "greeting" and not known:
            self._pinned, self._commanded = (sender, session), False
        return ""

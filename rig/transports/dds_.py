"""Two DDS topics readable by ROS 2 nodes, by Eclipse Cyclone DDS (extra `rig`); ROS itself is not needed."""

# No `from __future__ import annotations` here: cyclonedds reads the annotations as types.
import secrets
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from hystmpc.trials.errors import ConfigError

from ..axes import PerAxis, each, is_known
from .topics import (
    GOODBYE,
    GREETING,
    WRONG_SIZE,
    TopicMessage,
    TopicSettings,
    TopicTransport,
    listening,
    numbers,
    stamp,
    unknown,
)
from .transport import Admission, Conversion, DeviceLink, Incoming, Outgoing, Says

# Discovery and data on one interface; unicast, so that nothing is announced beyond it.
_XML = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="{name}"/></Interfaces>
<AllowMulticast>{multicast}</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>{peers}</Discovery></Domain></CycloneDDS>"""
_PEERS = '<Peers><Peer address="127.0.0.1"/></Peers>'


# Messages as ROS 2 lays them out; it names types package::msg::dds_::Name_.
@dataclass
class Float64(IdlStruct, typename="std_msgs::msg::dds_::Float64_"):  # type: ignore[call-arg]  # the base takes it
    """std_msgs/msg/Float64."""

    data: float64


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):  # type: ignore[call-arg]  # the base takes it
    """builtin_interfaces/msg/Time."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):  # type: ignore[call-arg]  # the base takes it
    """std_msgs/msg/Header."""

    stamp: Time
    frame_id: str


@dataclass
class Float64Stamped(IdlStruct, typename="hystmpc_msgs::msg::dds_::Float64Stamped_"):  # type: ignore[call-arg]  # the base takes it
    """hystmpc_msgs/msg/Float64Stamped: header, uint32 session, uint32 sequence, float64 data, float64 held."""

    header: Header
    session: uint32
    sequence: uint32
    data: float64
    held: float64


@dataclass
class Float64PairStamped(IdlStruct, typename="hystmpc_msgs::msg::dds_::Float64PairStamped_"):  # type: ignore[call-arg]  # the base takes it
    """hystmpc_msgs/msg/Float64PairStamped: as Float64Stamped, with float64[2] data and float64[2] held of two axes."""

    header: Header
    session: uint32
    sequence: uint32
    data: array[float64, 2]
    held: array[float64, 2]


@dataclass
class MultiArrayDimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):  # type: ignore[call-arg]  # the base takes it
    """std_msgs/msg/MultiArrayDimension."""

    label: str
    size: uint32
    stride: uint32


@dataclass
class MultiArrayLayout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):  # type: ignore[call-arg]  # the base takes it
    """std_msgs/msg/MultiArrayLayout."""

    dim: sequence[MultiArrayDimension]
    data_offset: uint32


@dataclass
class Float64MultiArray(IdlStruct, typename="std_msgs::msg::dds_::Float64MultiArray_"):  # type: ignore[call-arg]  # the base takes it
    """std_msgs/msg/Float64MultiArray; here of two numbers, without dimensions."""

    layout: MultiArrayLayout
    data: sequence[float64]


AnyMessage = Float64 | Float64Stamped | Float64PairStamped | Float64MultiArray
# Messages by their name in the settings and the number of axes. An end of one type does not hear the other ones.
MESSAGES: dict[tuple[str, int], type[AnyMessage]] = {
    ("float64", 1): Float64,
    ("float64", 2): Float64MultiArray,
    ("float64_stamped", 1): Float64Stamped,
    ("float64_stamped", 2): Float64PairStamped,
}
# Hashes of the types as ROS 2 computes them (RIHS01). A node that finds none warns about it, at each topic.
HASHES: dict[type[AnyMessage], str] = {
    Float64: "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    Float64MultiArray: "RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f",
    Float64Stamped: "RIHS01_490b10b0b6a6d4e6a295c81dd8f83fa393d69f76a87629b1f6bec6f5fd326251",
    Float64PairStamped: "RIHS01_b8ddb5aae915e1fa3ed508d50ed0ed9c713d8d7985a097d2e94dabf0ce947bf3",
}


class _Wire:
    def __init__(self, settings: TopicSettings, out: str, into: str, axes: int = 1) -> None:
        local = settings.interface is None
        xml = _XML.format(
            name=settings.interface or "lo",
            multicast="false" if local else "default",
            peers=_PEERS if local else "",
        )
        self.stamped = settings.message == "float64_stamped"
        kind: Any = MESSAGES[settings.message, axes]
        self._kind, self._axes = kind, axes
        qos = _qos(settings)
        hashed = qos + Qos(Policy.Userdata(f"typehash={HASHES[kind]};".encode()))
        try:
            self._domain = Domain(settings.domain, xml)
        except Exception:  # noqa: BLE001 - this process has opened the domain already; its settings stand
            self._domain = None
        try:
            participant = DomainParticipant(settings.domain)
            self._writer: Any = DataWriter(participant, Topic(participant, f"rt/{out}", kind, qos=qos), qos=hashed)
            self._reader: Any = DataReader(participant, Topic(participant, f"rt/{into}", kind, qos=qos), qos=hashed)
        except Exception as error:
            text = " ".join(str(error).split())
            raise ConfigError(f"dds: domain {settings.domain} cannot be joined ({text})") from error
        self._participant: Any = participant
        self.session, self._sequence, self._taken = secrets.randbits(32), 0, 0

    def write(
        self, value: PerAxis, held: PerAxis, sequence: int | None = None, stamp_ns: int | None = None, note: str = ""
    ) -> None:
        self._sequence += 1
        data, held_there = (one if self._axes == 1 else list(each(one)) for one in (value, held))
        if self.stamped:
            now = time.time_ns() if stamp_ns is None else stamp_ns
            number = (self._sequence if sequence is None else sequence) & 0xFFFFFFFF
            header = Header(stamp=Time(*stamp(now)), frame_id=note)
            self._writer.write(self._kind(header, self.session, number, data, held_there))
            return
        layout: Any = MultiArrayLayout
        self._writer.write(self._kind(data) if self._axes == 1 else self._kind(layout([], 0), data))

    def take(self) -> Any | None:
        samples = self._reader.take(1)
        sample = samples[0] if samples else None
        return sample if sample is not None and hasattr(sample, "data") else None

    def read(self) -> TopicMessage | None:
        message = self.take()
        if message is None:
            return None
        if self.stamped:
            return TopicMessage.of(message)
        self._taken += 1
        sent = int(message.sample_info.source_timestamp) - time.time_ns() + time.monotonic_ns()
        return TopicMessage(numbers(message.data), self._taken, sent, held=unknown(self._axes))

    def close(self) -> None:
        self._writer = self._reader = self._participant = self._domain = None


def _qos(settings: TopicSettings) -> Qos:
    wanted = settings.qos
    reliable = Policy.Reliability.Reliable(max_blocking_time=0)  # a full queue drops; it must not block the loop
    return Qos(
        reliable if wanted.reliability == "reliable" else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if wanted.durability == "transient_local" else Policy.Durability.Volatile,
        Policy.History.KeepLast(wanted.depth),
    )


def dds_transport(settings: TopicSettings, conversion: Conversion) -> TopicTransport:
    """Open the controller's end in a domain. The age of a message without a stamp counts from the sender's DDS stamp.

    Raises:
        ConfigError: if the domain cannot be joined.
    """
    wire = _Wire(settings, settings.command_topic, settings.angle_topic, conversion.axes)
    return TopicTransport(wire, conversion)


@final
class DdsLink(DeviceLink):
    """Device's end of the wire: reads the command topic, writes the angle topic, for one controller at a time.

    See `Admission`. A message without a stamp has no sessions: every command is accepted.

    Args:
        silence_s: silence of a controller after which another may take its place [s].
        axes: of the device.

    Raises:
        ConfigError: if the domain cannot be joined.
    """

    def __init__(self, settings: TopicSettings, silence_s: float, axes: int = 1) -> None:
        self._wire, self._axes = _Wire(settings, settings.angle_topic, settings.command_topic, axes), axes
        self._admission = Admission(silence_s)
        self._counters: Counter[str] = Counter()
        self.greeted = self._wire.stamped

    @property
    def counters(self) -> Mapping[str, int]:
        return self._counters

    def receive(self) -> Incoming | None:
        while (message := self._wire.take()) is not None:
            said = self._said(message) if self._wire.stamped else self._command(message.data)
            if isinstance(said, Incoming):
                return said
            self._counters[said] += 1
        return None

    def send(self, message: Outgoing) -> None:
        """Send a measurement and the session that is listened to."""
        stamp_ns = message.stamp_ns + time.time_ns() - time.monotonic_ns()  # ROS stamps are those of the wall clock
        session = self._admission.session if message.listens else None
        self._wire.write(message.angle, message.held, message.sequence, stamp_ns, listening(session))

    def close(self) -> None:
        self._wire.close()

    def _said(self, message: Any) -> Incoming | str:
        """Content of an admitted message from the writer that has greeted, or the reason of its refusal."""
        writer = message.sample_info.publication_handle
        come = writer, message.session, message.sequence, time.monotonic_ns()
        note = message.header.frame_id
        says: Says = note if note in (GREETING, GOODBYE) else "command"
        if reason := self._admission.admit(says, *come):
            return reason
        return self._command(message.data) if says == "command" else Incoming(says=says)

    def _command(self, data: Any) -> Incoming | str:
        raw = numbers(data)
        if len(each(raw)) != self._axes:
            return WRONG_SIZE
        return Incoming(raw) if is_known(raw) else "not-a-number"

"""Two DDS topics readable by ROS 2 nodes, by Eclipse Cyclone DDS (extra `rig`); ROS itself is not needed."""

# No `from __future__ import annotations` here: cyclonedds reads the annotations as types.
import math
import secrets
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from hystmpc.trials.errors import ConfigError

from .topics import GOODBYE, GREETING, TopicMessage, TopicSettings, TopicTransport, listening, stamp
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


# Hashes of the types as ROS 2 computes them (RIHS01). A node that finds none warns about it, at each topic.
HASHES: dict[type[Float64 | Float64Stamped], str] = {
    Float64: "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    Float64Stamped: "RIHS01_490b10b0b6a6d4e6a295c81dd8f83fa393d69f76a87629b1f6bec6f5fd326251",
}


class _Wire:
    def __init__(self, settings: TopicSettings, out: str, into: str) -> None:
        local = settings.interface is None
        xml = _XML.format(
            name=settings.interface or "lo",
            multicast="false" if local else "default",
            peers=_PEERS if local else "",
        )
        self.stamped = settings.message == "float64_stamped"
        kind: Any = Float64Stamped if self.stamped else Float64
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
        self, value: float, held: float, sequence: int | None = None, stamp_ns: int | None = None, note: str = ""
    ) -> None:
        self._sequence += 1
        if not self.stamped:
            self._writer.write(Float64(data=value))
            return
        now = time.time_ns() if stamp_ns is None else stamp_ns
        header = Header(stamp=Time(*stamp(now)), frame_id=note)
        number = (self._sequence if sequence is None else sequence) & 0xFFFFFFFF
        self._writer.write(Float64Stamped(header=header, session=self.session, sequence=number, data=value, held=held))

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
        return TopicMessage(message.data, self._taken, sent)

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
    """Open the controller's end in a domain. The age of a Float64 counts from the sender's DDS stamp.

    Raises:
        ConfigError: if the domain cannot be joined.
    """
    return TopicTransport(_Wire(settings, settings.command_topic, settings.angle_topic), conversion)


@final
class DdsLink(DeviceLink):
    """Device's end of the wire: reads the command topic, writes the angle topic, for one controller at a time.

    See `Admission`. Plain Float64 has no sessions: every command is accepted.

    Args:
        silence_s: silence of a controller after which another may take its place [s].

    Raises:
        ConfigError: if the domain cannot be joined.
    """

    def __init__(self, settings: TopicSettings, silence_s: float) -> None:
        self._wire = _Wire(settings, settings.angle_topic, settings.command_topic)
        self._admission = Admission(silence_s)
        self._counters: Counter[str] = Counter()
        self.greeted = self._wire.stamped

    @property
    def counters(self) -> Mapping[str, int]:
        return self._counters

    def receive(self) -> Incoming | None:
        while (message := self._wire.take()) is not None:
            said = self._said(message) if self._wire.stamped else _command(message.data)
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
        return _command(message.data) if says == "command" else Incoming(says=says)


def _command(raw: float) -> Incoming | str:
    return Incoming(raw) if math.isfinite(raw) else "not-a-number"

"""The messages of `ros2/hystmpc_msgs` are those of the DDS transport: names, fields, bytes, and what a domain sees."""

from __future__ import annotations

import dataclasses
import importlib.util
import struct
import time
from collections.abc import Callable
from typing import Any, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.rig.transports.dds import DdsSettings

from .interfaces import MSGS, PRIMITIVE, dds_name, interfaces

STAMPED, PAIR = "hystmpc_msgs/msg/Float64Stamped", "hystmpc_msgs/msg/Float64PairStamped"
needs_dds = pytest.mark.skipif(importlib.util.find_spec("cyclonedds") is None, reason="cyclonedds (extra rig)")
needs_rosbags = pytest.mark.skipif(importlib.util.find_spec("rosbags") is None, reason="rosbags (extra logs)")


def idl(kind: Any) -> list[tuple[str, str]]:
    """Fields of a type of the DDS transport, with the names that ROS has for their types."""
    hints = get_type_hints(kind, include_extras=True)
    found = []
    for field in dataclasses.fields(kind):
        of = hints[field.name]
        found.append((field.name, ros_type(of)))
    return found


def ros_type(of: Any) -> str:
    """The name in ROS of the type of a field."""
    if dataclasses.is_dataclass(of):
        return ros_name(of)
    if of is str:
        return "string"
    (said,) = of.__metadata__
    if isinstance(said, str):
        return said
    part = said.subtype
    return f"{ros_type(part)}[{getattr(said, 'length', '')}]"


def ros_name(kind: Any) -> str:
    """The name in ROS of a type of the DDS transport."""
    package, room, dds, last = kind.__idl_typename__.split("::")
    assert dds == "dds_"
    return f"{package}/{room}/{last.removesuffix('_')}"


def cdr(header: tuple[int, int, str], session: int, sequence: int, *numbers: float) -> bytes:
    """Stamped numbers as ROS writes them: CDR of XCDR1, little-endian, every number at a multiple of its size."""
    sec, nanosec, frame = header
    raw = frame.encode() + b"\0"
    body = struct.pack("<iII", sec, nanosec, len(raw)) + raw
    body += b"\0" * (-len(body) % 4) + struct.pack("<II", session, sequence)
    body += b"\0" * (-len(body) % 8) + struct.pack(f"<{len(numbers)}d", *numbers)
    return b"\x00\x01\x00\x00" + body


U32 = st.integers(0, 2**32 - 1)
NUMBER = st.floats(width=64, allow_nan=False)
STAMPS = st.tuples(
    st.integers(-(2**31), 2**31 - 1), U32, st.text(st.characters(codec="ascii", exclude_characters="\0"))
)
MESSAGES = st.tuples(STAMPS, U32, U32, NUMBER, NUMBER)
PAIRS = st.tuples(STAMPS, U32, U32, NUMBER, NUMBER, NUMBER, NUMBER)


@needs_dds
def test_types_of_the_transport_are_those_of_the_files() -> None:
    from hystmpc.rig.transports import dds_

    known = interfaces()
    parts = dds_.Header, dds_.Time, dds_.MultiArrayLayout, dds_.MultiArrayDimension
    for kind in (*dds_.MESSAGES.values(), *parts):
        assert idl(kind) == known[ros_name(kind)]
        assert kind.__idl_typename__ == dds_name(ros_name(kind))
    assert [ros_name(dds_.MESSAGES["float64_stamped", axes]) for axes in (1, 2)] == [STAMPED, PAIR]


@needs_dds
@given(MESSAGES | PAIRS)
def test_bytes_are_those_of_ros(message: Any) -> None:
    assert of_the_transport(message).serialize() == cdr(*message)


@needs_rosbags
@given(MESSAGES | PAIRS)
def test_rosbags_reads_the_same_file_to_the_same_bytes(message: Any) -> None:
    """rosbags reads the .msg file by its own rules."""
    store = store_of_rosbags()
    (sec, nanosec, frame), session, sequence, *numbers = message
    time_ = store.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    header = store.types["std_msgs/msg/Header"](stamp=time_, frame_id=frame)
    name, data, held = parted(numbers, np.array)
    made = store.types[name](header=header, session=session, sequence=sequence, data=data, held=held)
    assert bytes(store.serialize_cdr(made, name)) == cdr(*message)


@needs_rosbags
def test_rosbags_reads_every_message_as_these_tests_do() -> None:
    store = store_of_rosbags()
    for path in (MSGS / "msg").glob("*.msg"):
        found = store.types[f"hystmpc_msgs/msg/{path.stem}"]
        assert [field.name for field in dataclasses.fields(found) if field.name != "__msgtype__"] == [
            name for name, _ in interfaces()[f"hystmpc_msgs/msg/{path.stem}"]
        ]


@needs_dds
@needs_rosbags
def test_hashes_of_the_types_are_those_of_ros() -> None:
    from hystmpc.rig.transports.dds_ import HASHES

    store, names = store_of_rosbags(), (STAMPED, PAIR, "std_msgs/msg/Float64", "std_msgs/msg/Float64MultiArray")
    assert {ros_name(kind): known for kind, known in HASHES.items()} == {
        name: store.hash_rihs01(name) for name in names
    }


def test_every_type_that_is_used_is_known() -> None:
    known = interfaces()
    used = {of for parts in known.values() for _, of in parts}
    assert used - set(PRIMITIVE) <= known.keys()


def test_cmake_lists_every_file() -> None:
    text = (MSGS / "CMakeLists.txt").read_text(encoding="utf-8")
    files = [f'"{path.relative_to(MSGS).as_posix()}"' for path in sorted(MSGS.glob("*/*.*"))]
    assert [name for name in files if text.count(name) != 1] == []
    assert sum(text.count(f'{end}"') for end in (".msg", ".srv")) == len(files)


@needs_dds
def test_a_domain_sees_topics_types_and_bytes_as_ros_names_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """The angle's topic as another participant discovers and receives it."""
    from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
    from cyclonedds.core import Policy
    from cyclonedds.domain import DomainParticipant

    from hystmpc.rig.transports import dds_
    from hystmpc.rig.transports.transport import Conversion, Outgoing

    settings = DdsSettings.parse({"kind": "dds", "domain": 76})
    link, other = dds_.DdsLink(settings, 0.3), dds_.dds_transport(settings, Conversion(1.0, 0.0, 1.0))
    seen: list[bytes] = []
    read = dds_.Float64Stamped.deserialize
    monkeypatch.setattr(dds_.Float64Stamped, "deserialize", lambda data, **more: (seen.append(data), read(data))[1])
    try:
        link.send(Outgoing(42.5, 1.25, 7, time.monotonic_ns()))
        until = time.monotonic() + 5.0
        while (reading := other.read()) is None and time.monotonic() < until:
            link.send(Outgoing(42.5, 1.25, 7, time.monotonic_ns()))
            time.sleep(0.01)
        assert reading is not None
        participant = DomainParticipant(76)
        found = BuiltinDataReader(participant, BuiltinTopicDcpsPublication).take(10)
        names = {(one.topic_name, one.type_name) for one in found}
        said = {one.qos[Policy.Userdata].data for one in found}
    finally:
        other.stop()
        link.close()
    stamped = dds_name(STAMPED)
    assert names == {("rt/tip/angle_deg", stamped), ("rt/tip/command", stamped)}
    assert said == {f"typehash={dds_.HASHES[dds_.Float64Stamped]};".encode()}
    sec, nanosec, length = struct.unpack_from("<iII", seen[0], 4)
    frame = seen[0][16 : 16 + length - 1].decode()
    session = struct.unpack_from("<I", seen[0], 16 + length + -length % 4)[0]
    assert frame == "listens:none"
    assert seen[0] == cdr((sec, nanosec, frame), session, 7, 42.5, 1.25)


def parted(numbers: list[float], array: Callable[[list[float]], Any]) -> tuple[str, Any, Any]:
    """The type of a message with these numbers, its data and its held commands."""
    if len(numbers) == 2:
        return STAMPED, *numbers
    return PAIR, array(numbers[:2]), array(numbers[2:])


def of_the_transport(message: Any) -> Any:
    """The same message as the DDS transport writes it."""
    from hystmpc.rig.transports.dds_ import Float64PairStamped, Float64Stamped, Header, Time

    (sec, nanosec, frame), session, sequence, *numbers = message
    name, data, held = parted(numbers, list)
    kind: Any = Float64Stamped if name == STAMPED else Float64PairStamped
    return kind(Header(Time(sec, nanosec), frame), session, sequence, data, held)


def store_of_rosbags() -> Any:
    """Types of ROS 2 and of this package, read by rosbags."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for path in sorted((MSGS / "msg").glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"hystmpc_msgs/msg/{path.stem}"))
    return store

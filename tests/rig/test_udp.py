"""Datagrams over real sockets: round trips, and what hostile ones do, which is nothing."""

from __future__ import annotations

import math
import socket
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hystmpc.rig.transports.transport import Conversion, Incoming, Outgoing, Reading
from hystmpc.rig.transports.udp import KINDS, SIZE, Datagram, Kind, UdpLink, UdpSettings, UdpTransport, decode, encode
from hystmpc.trials.errors import ConfigError

SAME = Conversion(1.0, 0.0, 1.0)
MESSAGES = st.builds(
    Datagram,
    kind=st.sampled_from(list(Kind)),
    session=st.integers(0, 2**32 - 1),
    sequence=st.integers(0, 2**32 - 1),
    stamp_ns=st.integers(0, 2**64 - 1),
    value=st.floats(allow_nan=False),
    held=st.floats(allow_nan=False),
)


@pytest.fixture
def pair() -> Iterator[tuple[UdpTransport, UdpLink]]:
    """A controller's and a device's end that know each other."""
    link = UdpLink("127.0.0.1", 0, silence_s=0.3)
    transport = UdpTransport(UdpSettings(kind="udp", port=link.port), SAME)
    assert transport.read() is None  # greets
    assert wait_for(link.receive).says == "greeting"  # from Python 3.13 on no two with a command of NaN are equal
    yield transport, link
    transport.stop()
    link.close()


def wait_for(get: Callable[[], Any], seconds: float = 2.0) -> Any:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if (found := get()) is not None:
            return found
        time.sleep(0.001)
    raise AssertionError("nothing came")


@given(MESSAGES)
def test_a_datagram_goes_out_and_comes_back(message: Datagram) -> None:
    data = encode(message)
    assert len(data) == SIZE == 44
    assert decode(data) == message


@given(MESSAGES, st.integers(0, SIZE * 8 - 1))
def test_one_wrong_bit_is_found(message: Datagram, bit: int) -> None:
    data = bytearray(encode(message))
    data[bit // 8] ^= 1 << bit % 8
    assert decode(bytes(data)) == "wrong checksum"


@given(st.binary(max_size=100))
def test_rubbish_is_none(data: bytes) -> None:
    assert isinstance(decode(data), str)


@given(st.binary(min_size=SIZE - 4, max_size=SIZE - 4))
def test_rubbish_with_a_right_checksum_is_read_without_a_crash(body: bytes) -> None:
    found = decode(body + struct.pack("<I", zlib.crc32(body)))
    assert isinstance(found, str) or (body[:5] == b"HMPC\x01" and found.kind in KINDS.values())


def test_a_measurement_and_a_command_cross(pair: tuple[UdpTransport, UdpLink]) -> None:
    transport, link = pair
    link.send(Outgoing(42.5, 1.25, 7, 123))
    reading = wait_for(transport.read)
    assert isinstance(reading, Reading)
    assert (reading.angle_deg, reading.held, reading.sequence, reading.sent_ns) == (42.5, 1.25, 7, 123)
    transport.write(2.5)
    assert wait_for(link.receive) == Incoming(2.5)
    transport.stop(goodbye=True)
    assert wait_for(link.receive).says == "goodbye"


@given(st.lists(st.one_of(st.binary(max_size=60), MESSAGES.map(encode)), max_size=20))
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_hostile_datagrams_move_no_device(pair: tuple[UdpTransport, UdpLink], data: list[bytes]) -> None:
    """From another address, whatever they hold: no command is taken while a controller has the device."""
    transport, link = pair
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for datagram in data:
            stranger.sendto(datagram, ("127.0.0.1", link.port))
    transport.write(1.5)
    got = [wait_for(link.receive)]
    while (more := link.receive()) is not None:
        got.append(more)
    assert got == [Incoming(1.5)]


def test_replayed_and_broken_commands_of_the_right_sender_are_counted(pair: tuple[UdpTransport, UdpLink]) -> None:
    transport, link = pair
    transport.write(1.0)
    wait_for(link.receive)
    wire, session = transport._wire, transport._session
    broken = {
        "replayed-or-reordered": encode(Datagram(Kind.COMMAND, session, transport._sequence, 0, 5.0)),
        "not-a-number": encode(Datagram(Kind.COMMAND, session, transport._sequence + 1, 0, math.nan)),
        "wrong size": b"HMPC",
        "wrong checksum": bytes(SIZE),
        "not a command": encode(Datagram(Kind.READING, session, transport._sequence + 2, 0, 5.0)),
    }
    for data in broken.values():
        wire.send(data)
    transport._sequence += 10
    transport.write(2.0)
    assert wait_for(link.receive) == Incoming(2.0)
    assert {cause: link.counters[cause] for cause in broken} == dict.fromkeys(broken, 1)


def test_only_a_reading_is_taken_for_one(pair: tuple[UdpTransport, UdpLink]) -> None:
    """Greetings, commands and goodbyes that come back are no angles."""
    transport, link = pair
    for kind in Kind:
        if kind is not Kind.READING:
            link._wire.sendto(encode(Datagram(kind, 1, 1, 0, 55.0)), link._peer)
    link.send(Outgoing(42.5, 0.0, 7, 1))
    assert wait_for(transport.read).angle_deg == 42.5
    assert transport.counters["not a reading"] == 3


def test_a_second_controller_is_heard_only_after_the_first_has_left(pair: tuple[UdpTransport, UdpLink]) -> None:
    transport, link = pair
    other = UdpTransport(UdpSettings(kind="udp", port=link.port), SAME)
    other.read()
    other.write(6.0)
    transport.write(1.0)
    assert wait_for(link.receive) == Incoming(1.0)
    assert link.counters["another controller"] == 2
    transport.stop(goodbye=True)
    assert wait_for(link.receive).says == "goodbye"
    other.greet()
    other.write(2.0)
    assert wait_for(link.receive).says == "greeting"
    assert wait_for(link.receive) == Incoming(2.0)
    other.stop()


def test_goodbye_to_a_device_that_is_not_there_is_no_error() -> None:
    """A run that finds no device says so, and nothing else."""
    link = UdpLink("127.0.0.1", 0, 1.0)
    transport = UdpTransport(UdpSettings(kind="udp", port=link.port), SAME)
    link.close()
    with pytest.raises(ConnectionRefusedError):
        wait_for(transport.read)
    transport.stop()
    transport.stop()
    assert transport.counters["nobody listens"] >= 1


def test_a_taken_port_is_said_in_one_line(pair: tuple[UdpTransport, UdpLink]) -> None:
    with pytest.raises(
        ConfigError, match=r"cannot listen at 127\.0\.0\.1 port \d+ \(Address already in use\), expected a free one"
    ):
        UdpLink("127.0.0.1", pair[1].port, 1.0)

"""DDS topics between real participants, and the bytes that ROS 2 would read."""

from __future__ import annotations

import importlib.util
import math
import struct
import time
from collections.abc import Callable
from typing import Any

import pytest

from hystmpc.rig.axes import each, together
from hystmpc.rig.transports import dds
from hystmpc.rig.transports.dds import DdsSettings
from hystmpc.rig.transports.transport import Conversion, Incoming, Outgoing
from hystmpc.trials.errors import ConfigError

HAS_DDS = importlib.util.find_spec("cyclonedds") is not None
needs_dds = pytest.mark.skipif(not HAS_DDS, reason="cyclonedds (extra rig) is not installed")
SAME = {1: Conversion(1.0, 0.0, 1.0), 2: Conversion(together((1.0, 1.0)), together((0.0, 0.0)), 1.0)}
ONE, PAIR = {1: 42.5, 2: together((42.5, -3.5))}, {1: 2.5, 2: together((2.5, -0.5))}
HELD = {1: 1.25, 2: together((1.25, -0.25))}
of_each_message = pytest.mark.parametrize("message", ["float64", "float64_stamped"])


def until(get: Callable[[], Any], seconds: float = 5.0) -> Any:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if (found := get()) is not None:
            return found
        time.sleep(0.002)
    raise AssertionError("nothing came")


@needs_dds
def test_messages_have_the_bytes_of_ros() -> None:
    """CDR, little-endian: a four-byte header, then the fields, aligned from there; strings with length and NUL."""
    from hystmpc.rig.transports.dds_ import Float64, Float64Stamped, Header, Time

    assert Float64(data=1.5).serialize() == b"\x00\x01\x00\x00" + struct.pack("<d", 1.5)
    assert Float64.__idl_typename__ == "std_msgs::msg::dds_::Float64_"
    message = Float64Stamped(header=Header(Time(5, 7), "tip"), session=3, sequence=4, data=2.5, held=0.5)
    body = struct.pack("<iII4sIIdd", 5, 7, 4, b"tip\0", 3, 4, 2.5, 0.5)
    assert message.serialize() == b"\x00\x01\x00\x00" + body


@needs_dds
def test_messages_of_two_axes_have_the_bytes_of_ros() -> None:
    """An array of fixed length is its numbers; one of any length has its count in front."""
    from hystmpc.rig.transports.dds_ import Float64MultiArray, Float64PairStamped, Header, MultiArrayLayout, Time

    message = Float64PairStamped(Header(Time(5, 7), "tip"), session=3, sequence=4, data=[2.5, -1.0], held=[0.5, 0.0])
    body = struct.pack("<iII4sIIdddd", 5, 7, 4, b"tip\0", 3, 4, 2.5, -1.0, 0.5, 0.0)
    assert message.serialize() == b"\x00\x01\x00\x00" + body
    plain = Float64MultiArray(MultiArrayLayout(dim=[], data_offset=0), [2.5, -1.0])
    assert plain.serialize() == b"\x00\x01\x00\x00" + struct.pack("<III4xdd", 0, 0, 2, 2.5, -1.0)


@needs_dds
@pytest.mark.slow
@pytest.mark.parametrize("axes", [1, 2])
@of_each_message
def test_a_measurement_and_a_command_cross(message: str, axes: int) -> None:
    from hystmpc.rig.transports.dds_ import DdsLink, dds_transport

    settings = DdsSettings.parse({"kind": "dds", "domain": 73, "message": message})
    link, transport = DdsLink(settings, 0.3, axes), dds_transport(settings, SAME[axes])
    try:

        def measured() -> Any:
            link.send(Outgoing(ONE[axes], HELD[axes], 7, time.monotonic_ns()))
            return transport.read()

        def commanded() -> Any:
            transport.write(PAIR[axes])
            return link.receive()

        reading = until(measured)
        assert reading.angle_deg == ONE[axes]
        assert len(each(reading.held)) == axes
        assert abs(reading.received_ns - time.monotonic_ns()) < 5e9
        stamped = message == "float64_stamped"
        assert reading.listens != stamped
        if stamped:
            assert (reading.sequence, reading.held) == (7, HELD[axes])
            transport.greet()
            assert until(link.receive).says == "greeting"
            assert until(lambda: (found := measured()) and found.listens and found).listens
        assert until(commanded) == Incoming(PAIR[axes])
        transport.write(together([*each(PAIR[axes])[:-1], math.nan]))
        transport.stop(goodbye=True)
        if stamped:
            assert until(lambda: (m := link.receive()) and m.says == "goodbye" and m).says == "goodbye"
            assert link.counters["not-a-number"] == 1
    finally:
        transport.stop()
        link.close()


def test_without_the_package_dds_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dds.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install hystmpc\[rig\]"):
        dds.require_dds()


@needs_dds
@pytest.mark.slow
@of_each_message
@pytest.mark.parametrize("axes", [1, 2])
def test_neither_a_device_nor_a_controller_hears_the_message_of_the_other_number_of_axes(
    message: str, axes: int
) -> None:
    """A controller of one axis cannot move a device of two, nor the other way round."""
    from hystmpc.rig.transports.dds_ import DdsLink, dds_transport

    settings = DdsSettings.parse({"kind": "dds", "domain": 78, "message": message})
    link, right = DdsLink(settings, 0.3, axes), dds_transport(settings, SAME[axes])
    wrong = dds_transport(settings, SAME[3 - axes])
    try:

        def measured() -> Any:
            link.send(Outgoing(ONE[axes], HELD[axes], 7, time.monotonic_ns()))
            return right.read()

        until(measured)
        for _ in range(50):
            wrong.greet()
            wrong.write(PAIR[3 - axes])
            measured()
            time.sleep(0.01)
        assert wrong.read() is None
        assert link.receive() is None
    finally:
        right.stop()
        wrong.stop()
        link.close()


@needs_dds
@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 3])
def test_an_array_of_another_length_is_counted_and_moves_nothing(count: int) -> None:
    """Any node may publish std_msgs/msg/Float64MultiArray of any length."""
    from hystmpc.rig.transports.dds_ import DdsLink, Float64MultiArray, MultiArrayLayout, dds_transport

    settings = DdsSettings.parse({"kind": "dds", "domain": 79, "message": "float64"})
    link, transport = DdsLink(settings, 0.3, 2), dds_transport(settings, SAME[2])
    odd = Float64MultiArray(MultiArrayLayout(dim=[], data_offset=0), [1.0] * count)
    try:

        def commanded() -> Any:
            transport.write(PAIR[2])
            return link.receive()

        def measured() -> Any:
            link.send(Outgoing(ONE[2], HELD[2], 7, time.monotonic_ns()))
            return transport.read()

        until(commanded)
        until(measured)
        for counters, take, writer in (
            (link.counters, link.receive, transport._wire._writer),
            (transport.counters, transport.read, link._wire._writer),
        ):
            writer.write(odd)
            until(lambda take=take, counters=counters: (take() and None) or counters.get("wrong size"))
            assert dict(counters) == {"wrong size": 1}
    finally:
        transport.stop()
        link.close()

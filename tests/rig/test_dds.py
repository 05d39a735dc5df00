"""DDS topics between real participants, and the bytes that ROS 2 would read."""

from __future__ import annotations

import importlib.util
import math
import struct
import time
from collections.abc import Callable
from typing import Any

import pytest

from hystmpc.rig.transports import dds
from hystmpc.rig.transports.dds import DdsSettings
from hystmpc.rig.transports.transport import Conversion, Incoming, Outgoing
from hystmpc.trials.errors import ConfigError

HAS_DDS = importlib.util.find_spec("cyclonedds") is not None
needs_dds = pytest.mark.skipif(not HAS_DDS, reason="cyclonedds (extra rig) is not installed")
SAME = Conversion(1.0, 0.0, 1.0)


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
@pytest.mark.slow
@pytest.mark.parametrize("message", ["float64", "float64_stamped"])
def test_a_measurement_and_a_command_cross(message: str) -> None:
    from hystmpc.rig.transports.dds_ import DdsLink, dds_transport

    settings = DdsSettings.parse({"kind": "dds", "domain": 73, "message": message})
    link, transport = DdsLink(settings, 0.3), dds_transport(settings, SAME)
    try:

        def measured() -> Any:
            link.send(Outgoing(42.5, 1.25, 7, time.monotonic_ns()))
            return transport.read()

        def commanded() -> Any:
            transport.write(2.5)
            return link.receive()

        reading = until(measured)
        assert reading.angle_deg == 42.5
        assert abs(reading.received_ns - time.monotonic_ns()) < 5e9
        stamped = message == "float64_stamped"
        assert reading.listens != stamped
        if stamped:
            assert (reading.sequence, reading.held) == (7, 1.25)
            transport.greet()
            assert until(link.receive).says == "greeting"
            assert until(lambda: (found := measured()) and found.listens and found).listens
        assert until(commanded) == Incoming(2.5)
        transport.write(math.nan)
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

"""Faults of datagrams over real sockets: what the device takes is right and in order, or it takes nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from hystmpc.rig.device import DeviceSettings, FaultSettings, FaultyDatagrams
from hystmpc.rig.transports.transport import Conversion, Outgoing
from hystmpc.rig.transports.udp import UdpLink, UdpSettings, UdpTransport
from hystmpc.trials.errors import ConfigError

SENT = [0.1 * k for k in range(40)]
Pair = Callable[..., tuple[UdpTransport, UdpLink]]


@pytest.fixture
def pair() -> Iterator[Pair]:
    """Makes a controller's and a device's end that know each other, with a fault between them."""
    made: list[Any] = []

    def make(**fault: object) -> tuple[UdpTransport, UdpLink]:
        faults = [FaultSettings.parse(fault)]
        link = UdpLink("127.0.0.1", 0, 5.0, lambda wire: FaultyDatagrams(wire, faults, seed=0))
        transport = UdpTransport(UdpSettings(kind="udp", port=link.port), Conversion(1.0, 0.0, 1.0))
        made.extend((transport.stop, link.close))
        transport.read()
        until = time.monotonic() + 2
        while link._peer is None and time.monotonic() < until:
            link.receive()
        return transport, link

    yield make
    for end in made:
        end()


def received(transport: UdpTransport, link: UdpLink) -> list[float]:
    """What the device takes of `SENT`, one after another."""
    got = []
    for command in SENT:
        transport.write(command)
        time.sleep(0.001)
        while (message := link.receive()) is not None:
            got.append(message.command)
    return got


@pytest.mark.parametrize("fault", ["duplicate", "replay"])
def test_repeated_commands_change_nothing(pair: Pair, fault: str) -> None:
    transport, link = pair(fault=fault, of="commands")
    assert received(transport, link) == SENT
    assert link.counters["replayed-or-reordered"] >= len(SENT) - 1


def test_spoiled_commands_are_refused_by_their_checksum_and_the_others_taken(pair: Pair) -> None:
    transport, link = pair(fault="corrupt", of="commands", share=0.5)
    got = received(transport, link)
    assert 5 < len(got) < 35
    assert set(got) <= set(SENT)
    assert len(got) + sum(link.counters.values()) == len(SENT)


def test_commands_out_of_order_never_lead_back(pair: Pair) -> None:
    transport, link = pair(fault="reorder", of="commands")
    got = received(transport, link)
    assert got == sorted(set(got))
    assert len(got) == len(SENT) // 2


def test_lost_and_late_commands(pair: Pair) -> None:
    transport, link = pair(fault="dropout", of="commands")
    assert received(transport, link) == []
    transport, link = pair(fault="delay", of="commands", delay_s=0.05)
    transport.write(1.0)
    time.sleep(0.02)
    assert link.receive() is None
    time.sleep(0.06)
    message = link.receive()
    assert message is not None
    assert message.command == 1.0


def test_spoiled_readings_are_refused_by_the_controller(pair: Pair) -> None:
    transport, link = pair(fault="corrupt")
    link.send(Outgoing(30.0, 0.0, 0, 1))  # before the first command nothing goes wrong
    transport.write(1.0)
    time.sleep(0.01)
    assert link.receive() is not None
    link.send(Outgoing(31.0, 0.0, 1, 2))
    time.sleep(0.01)
    found = [transport.read() for _ in range(3)]
    assert [reading.angle_deg for reading in found if reading is not None] == [30.0]
    assert sum(transport.counters.values()) == 1


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"faults": [{"fault": "freeze", "of": "commands"}]}, "got fault freeze of commands, available for them"),
        ({"faults": [{"fault": "corrupt"}], "link": {"kind": "dds"}}, "got fault corrupt of readings with link dds"),
    ],
)
def test_faults_that_cannot_be_are_refused(change: dict[str, Any], expected: str) -> None:
    plain = {
        "rate_hz": 25,
        "command_unit": "mm",
        "plant": {"simulator": "builtin:pi"},
        "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
        "link": {"kind": "udp"},
    }
    with pytest.raises(ConfigError, match=expected):
        DeviceSettings.parse(plain | change)

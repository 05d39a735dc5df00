"""Which controller a device listens to, when its watchdog acts, and what may end that: over every wire."""

from __future__ import annotations

import importlib.util
import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.rig.axes import each, together
from hystmpc.rig.device import DeviceSettings, SimulatedDevice
from hystmpc.rig.transports.dds import DdsSettings
from hystmpc.rig.transports.transport import ANOTHER, NO_GREETING, OLD, Admission, Conversion, Incoming, Outgoing, Says
from hystmpc.rig.transports.udp import UdpLink, UdpSettings, UdpTransport

SAME = {1: Conversion(1.0, 0.0, 1.0), 2: Conversion(together((1.0, 1.0)), together((0.0, 0.0)), 1.0)}
S = 1_000_000_000
DT, RATE = 0.04, 10.0


def test_a_session_is_pinned_by_its_greeting_and_freed_by_goodbye_or_silence() -> None:
    desk = Admission(0.5)
    assert desk.admit("command", "a", 1, 1, 0) == NO_GREETING
    assert desk.admit("greeting", "a", 1, 2, 0) == ""
    assert desk.admit("command", "a", 1, 3, 0) == ""
    assert desk.admit("greeting", "b", 2, 1, S // 4) == ANOTHER
    assert desk.admit("command", "b", 2, 2, S // 4) == ANOTHER
    assert desk.admit("goodbye", "b", 2, 3, S // 4) == ANOTHER
    assert desk.admit("command", "a", 2, 4, S // 4) == ANOTHER  # right sender, wrong session
    assert desk.admit("command", "b", 1, 4, S // 4) == ANOTHER  # right session, another sender
    assert desk.admit("command", "a", 1, 3, S // 4) == OLD
    assert desk.admit("command", "a", 1, 4, S // 4) == ""
    assert desk.admit("greeting", "b", 2, 4, S) == ""  # three quarters of a second later
    assert desk.admit("command", "a", 1, 5, S) == ANOTHER
    assert desk.admit("goodbye", "b", 2, 5, S) != ""  # it has never commanded: the device is told nothing
    assert desk.session is None
    assert desk.admit("greeting", "a", 1, 6, S) == OLD  # a session that has ended
    assert desk.admit("greeting", "c", 3, 1, S) == ""
    assert desk.admit("command", "c", 3, 2, S) == ""
    assert desk.admit("goodbye", "c", 3, 3, S) == ""


@given(
    st.lists(
        st.tuples(
            st.sampled_from(get_args(Says)),
            st.integers(1, 3),
            st.integers(1, 3),
            st.integers(0, 60),
        ),
        max_size=40,
    )
)
def test_what_others_send_changes_nothing_for_the_pinned_session(messages: list[tuple[Says, int, int, int]]) -> None:
    """Any messages of any other session and sender, in any order, while the pinned one is not silent."""
    desk = Admission(0.5)
    assert desk.admit("greeting", "mine", 9, 1, 0) == ""
    for k, (says, session, sender, sequence) in enumerate(messages):
        now = k * S // 100
        assert desk.admit(says, f"other {sender}", session, sequence, now) == ANOTHER
        assert desk.admit(says, f"other {sender}", 9, k + 2, now) == ANOTHER
        assert desk.admit("command", "mine", 9, k + 2, now) == ""


@dataclass
class ListLink:
    """A wire that is a list."""

    greeted: bool = True
    come: deque[Incoming] = field(default_factory=deque)
    sent: list[Outgoing] = field(default_factory=list)

    @property
    def counters(self) -> Mapping[str, int]:
        return {}

    def receive(self) -> Incoming | None:
        return self.come.popleft() if self.come else None

    def send(self, message: Outgoing) -> None:
        self.sent.append(message)

    def close(self) -> None:
        pass


class Straight:
    """A plant whose angle is ten times the command."""

    dt = DT

    def reset(self) -> float:
        return 0.0

    def apply(self, u: float) -> float:
        return 10.0 * u

    def stop(self) -> None:
        pass


class Drive:
    """A device and what it holds, sample by sample."""

    def __init__(self, greeted: bool = True) -> None:
        self.link = ListLink(greeted)
        settings = DeviceSettings.parse(
            {
                "rate_hz": 25,
                "command_unit": "mm",
                "plant": {},
                "limits": {"lower": 0, "upper": 6, "rate_per_s": RATE},
                "link": {"kind": "udp"},
            }
        )
        self.device, self.k = SimulatedDevice(settings, Straight(), 0.0, self.link), 0

    def samples(self, count: int, *messages: Incoming) -> list[float]:
        """What it holds after each of `count` samples; the messages come in every one of them."""
        held = []
        for _ in range(count):
            self.link.come.extend(messages)
            self.device.sample(self.k * DT)
            self.k += 1
            held.append(self.link.sent[-1].held)
        return held

    def at(self, command: float) -> Drive:
        """Greeted, and at a command."""
        self.samples(1, Incoming(says="greeting"))
        assert self.samples(30, Incoming(command))[-1] == pytest.approx(command)
        return self


def test_the_watchdog_bites_half_a_second_after_the_last_command_and_leads_to_rest() -> None:
    drive = Drive().at(4.0)
    assert min(drive.samples(11)) == 4.0
    back = drive.samples(60)
    assert back[:3] == pytest.approx([3.92, 3.84, 3.76])
    assert back[-1] == 0.0


@pytest.mark.parametrize("command", [6.0, 60.0, -60.0])
def test_the_drive_keeps_its_own_limits_whatever_is_commanded(command: float) -> None:
    drive = Drive().at(2.0)
    held = drive.samples(40, Incoming(command))
    assert max(abs(b - a) for a, b in pairwise([2.0, *held])) <= RATE * DT + 1e-9
    assert held[-1] == min(max(command, 0.0), 6.0)


def test_after_the_watchdog_commands_want_a_new_greeting() -> None:
    drive = Drive().at(4.0)
    drive.samples(20)
    falling = drive.samples(10, Incoming(4.0))
    assert falling == sorted(falling, reverse=True)
    assert not drive.link.sent[-1].listens
    drive.samples(1, Incoming(says="greeting"))
    assert drive.link.sent[-1].listens
    assert drive.samples(5)[-1] < falling[-1]  # a greeting alone does not end the return
    assert drive.samples(30, Incoming(4.0))[-1] == pytest.approx(4.0)


def test_without_greetings_a_command_is_taken_where_the_drive_is() -> None:
    """Plain Float64 has no sessions: the motion is taken up without a jump, or not at all."""
    drive = Drive(greeted=False)
    drive.samples(30, Incoming(4.0))
    assert drive.samples(80, Incoming(4.0))[-1] == 4.0
    drive.samples(20)
    assert drive.samples(80, Incoming(4.0))[-1] == 0.0
    assert drive.samples(5, Incoming(0.1))[-1] == pytest.approx(0.1)
    assert drive.samples(30, Incoming(4.0))[-1] == pytest.approx(4.0)


@pytest.mark.parametrize("silent", [0, 5, 30])
def test_a_goodbye_away_from_rest_does_not_disarm_the_watchdog(silent: int) -> None:
    """Before the watchdog has bitten, and while it returns."""
    drive = Drive().at(4.0)
    drive.samples(silent)
    drive.samples(1, Incoming(says="goodbye"))
    assert drive.samples(80)[-1] == 0.0


def test_a_goodbye_at_rest_ends_the_watch() -> None:
    drive = Drive().at(0.0)
    drive.samples(1, Incoming(says="goodbye"))
    drive.samples(40)
    assert drive.device._trips == 0


@dataclass
class Wire:
    """Two controllers and a device on a real wire."""

    link: Any
    first: Any
    second: Any
    axes: int
    _sequence: int = 0

    def value(self, one: float) -> Any:
        """The number, or a pair of it and its opposite."""
        return one if self.axes == 1 else together((one, -one))

    def until(self, get: Callable[[], Any], seconds: float = 5.0) -> Any:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if found := get():
                return found
            self._sequence += 1
            self.link.send(Outgoing(self.value(40.0), self.value(0.0), self._sequence, time.monotonic_ns()))
            time.sleep(0.005)
        raise AssertionError("nothing came")

    def said(self, says: str) -> bool:
        message = self.link.receive()
        return message is not None and message.says == says

    def heard(self, transport: Any) -> None:
        """The transport reads until it has been listened to."""

        def listens() -> bool:
            self.link.receive()
            reading = transport.read()
            if reading is not None and not reading.listens:
                transport.greet()
            return reading is not None and reading.listens

        self.until(listens)


HAS_DDS = importlib.util.find_spec("cyclonedds") is not None
DDS = pytest.param("dds", marks=[pytest.mark.slow, pytest.mark.skipif(not HAS_DDS, reason="cyclonedds (extra rig)")])


@pytest.fixture(params=["udp", DDS])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(params=[1, 2], ids=["one-axis", "two-axes"])
def wire(kind: str, request: pytest.FixtureRequest) -> Iterator[Wire]:
    axes = request.param
    made: Wire
    if kind == "udp":
        served = UdpLink("127.0.0.1", 0, 0.3, axes=axes)
        settings = UdpSettings(kind="udp", port=served.port)
        made = Wire(served, UdpTransport(settings, SAME[axes]), UdpTransport(settings, SAME[axes]), axes)
    else:
        from hystmpc.rig.transports.dds_ import DdsLink, dds_transport

        topics = DdsSettings.parse({"kind": "dds", "domain": 74})
        link = DdsLink(topics, 0.3, axes)  # first: whoever opens the domain of this process closes it for all
        made = Wire(link, dds_transport(topics, SAME[axes]), dds_transport(topics, SAME[axes]), axes)
    yield made
    made.first.stop()
    made.second.stop()
    made.link.close()


def test_a_second_controller_leaves_the_first_one_unharmed(wire: Wire) -> None:
    """It greets, commands and says goodbye: the first one's next command is taken all the same."""
    wire.heard(wire.first)
    taken = []
    for k in range(20):
        wire.first.write(wire.value(0.1 * k))
        if wire.second.read() is None:
            wire.second.greet()
        wire.second.write(wire.value(6.0))
        time.sleep(0.01)
        wire.link.send(Outgoing(wire.value(40.0), wire.value(0.0), 1000 + k, time.monotonic_ns()))
        while (message := wire.link.receive()) is not None:
            taken.append(message)
    wire.second.stop(goodbye=True)
    wire.first.write(wire.value(2.0))
    taken.append(wire.until(wire.link.receive))
    assert {message.says for message in taken} == {"command"}
    assert [message.command for message in taken] == [
        *(pytest.approx(wire.value(0.1 * k)) for k in range(20)),
        wire.value(2.0),
    ]
    assert wire.link.counters[ANOTHER] >= 20


def test_a_session_that_has_never_commanded_says_no_goodbye(wire: Wire) -> None:
    wire.heard(wire.first)
    wire.first.stop(goodbye=True)
    time.sleep(0.1)
    messages = []
    while (message := wire.link.receive()) is not None:
        messages.append(message.says)
    assert "goodbye" not in messages


def test_without_a_goodbye_nothing_is_said_at_the_end(wire: Wire) -> None:
    wire.heard(wire.first)
    wire.first.write(wire.value(1.0))
    wire.until(lambda: wire.said("command"))
    wire.first.stop()
    time.sleep(0.1)
    assert wire.link.receive() is None


def test_a_command_that_is_no_number_is_refused(wire: Wire) -> None:
    wire.heard(wire.first)
    wire.first.write(together([*each(wire.value(1.0))[:-1], math.nan]))
    wire.first.write(wire.value(1.5))
    assert wire.until(wire.link.receive) == Incoming(wire.value(1.5))
    assert wire.link.counters["not-a-number"] == 1

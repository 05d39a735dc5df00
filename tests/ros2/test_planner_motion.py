"""The planner without ROS, on a clock that obeys, at a device with a watchdog: what it may never do to the device."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.load import load_model
from hystmpc.models.prediction.build import predictor_for
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.experiment import Steering
from hystmpc.rig.transports.transport import Reading

from ..codegen.compiled import EXAMPLES
from ..rig.bench_parts import NS, FakeClock, ScriptedTransport
from .interfaces import ROS2
from .ros import forget

DT_NS = 40_000_000
START_DEG, START_MM = 45.0, 2.0


@pytest.fixture(scope="module")
def steering() -> Steering:
    return Steering(EXAMPLES / "tip.yaml")


@pytest.fixture(scope="module")
def planner_class() -> Iterator[Any]:
    """The class, without the modules of ROS beside it."""
    folder = str(ROS2 / "hystmpc_ros")
    forget("hystmpc_ros")
    sys.path.insert(0, folder)
    try:
        from hystmpc_ros.planner import Planner  # type: ignore[import-not-found]

        yield Planner
    finally:
        sys.path.remove(folder)
        forget("hystmpc_ros")


@dataclass
class Catheter(ScriptedTransport):
    """The device of `ScriptedTransport` with the angle of the model at the command held, and a session."""

    session: int = 1
    listens: bool = True
    off_deg: float = 0.0
    blocked: bool = False
    asked: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.predictor = predictor_for(load_model("builtin:tendon-catheter", "conditioned"))
        self.state = self.predictor.initial(START_DEG, START_MM)
        self.angle = START_DEG
        self.spoilt: Callable[[Reading], list[Reading]] = lambda found: [found]
        self.queue: list[Reading] = []

    def measure(self) -> None:
        """One sample of the device: its angle is on its way."""
        self._live()
        if not self.blocked:
            angle, self.state = self.predictor.advance(self.state, self.held)
            self.angle = float(angle)
        self._sequence += 1
        now = self.clock.ns
        angle = self.angle + self.off_deg + 1e-6 * self._sequence
        self.queue += self.spoilt(Reading(angle, self._sequence, self.session, now, now, self.held, self.listens))

    def read(self) -> Reading | None:
        return self.queue.pop(0) if self.queue else None


@dataclass
class Node:
    """A planner, its device, and the timer that calls it."""

    steering: Steering
    make: Any
    parameters: dict[str, Any] = field(default_factory=dict)
    holds: bool = False

    def __post_init__(self) -> None:
        self.clock = FakeClock()
        self.device = Catheter(self.clock, lambda k, u: None, held=START_MM, watchdog=True)
        self.steering.tip.reset()
        limits = self.steering.limits
        self.limits = limits
        blocks = {
            "name": "node",
            "rate_hz": 25.0,
            "command_unit": self.steering.unit,
            "limits": {"lower": limits.lower, "upper": limits.upper, "rate_per_s": limits.rate},
            "safe_command": 0.0,
            "sensor": {"lower_deg": 0.0, "upper_deg": 180.0},
            "transport": {"kind": "udp"},
        }
        self.bench = BenchSettings.parse(blocks | self.parameters)
        self.planner = self.make(self.bench, self.steering, self.device, self.clock)

    def turns(self, count: int, asleep_ns: int = 0) -> Node:
        """Periods of device and timer; the node may be asleep before."""
        for k in range(count):
            self.clock.ns += DT_NS + (asleep_ns if k == 0 else 0)
            self.device.measure()
            before = self.device.held
            sent = len(self.device.sent)
            self.planner.sample()
            for u in self.device.sent[sent:]:
                assert abs(u - before) <= self.limits.rate * 1e-9 * DT_NS + 1e-9
                assert self.limits.lower <= u <= self.limits.upper
        return self

    @property
    def stopped(self) -> bool:
        return bool(self.planner.tip.state().stopped)


@pytest.fixture
def node(steering: Steering, planner_class: Any) -> Node:
    return Node(steering, planner_class)


def rise_after(node: Node, moment_ns: int) -> float:
    """How far the device has moved away from the safe command since a moment."""
    held = [u for t, u in node.device.history if t >= moment_ns]
    return max((b - a for k, a in enumerate(held) for b in held[k:]), default=0.0)


def test_after_seconds_of_standstill_nothing_leads_up_again(node: Node) -> None:
    """The device was made safe by its watchdog; the planner finds it there, latches the stop and leaves it there."""
    node.turns(10).planner.tip.set_target(80.0)
    node.turns(60)
    assert node.device.held > 3.0
    moment = node.clock.ns + 4 * NS
    node.turns(1, 4 * NS)
    assert node.device.held == 0.0
    node.turns(100)
    assert rise_after(node, moment) == 0.0
    assert node.stopped
    assert "stood still" in node.planner.status
    node.planner.reset()
    node.turns(10).planner.tip.set_target(60.0)
    assert node.turns(100).device.held > 1.0


@given(at=st.integers(0, 60), pause_s=st.floats(0.13, 5.0), target=st.floats(20.0, 85.0))
@settings(max_examples=25, deadline=None)
def test_after_any_pause_the_device_never_moves_away_from_safe(
    steering: Steering, planner_class: Any, at: int, pause_s: float, target: float
) -> None:
    """Any pause at any moment of a motion; where the device was safe before the pause ended, it stays so."""
    node = Node(steering, planner_class)
    node.turns(10).planner.tip.set_target(target)
    node.turns(at)
    before = node.device.held
    node.turns(1, round(pause_s * NS))
    found = node.device.held
    resumed = node.clock.ns
    node.turns(100)
    if found < before - 0.1 or pause_s > 0.6:  # the watchdog has acted
        assert node.stopped
        assert rise_after(node, resumed) <= node.bench.overshoot + node.limits.rate * 0.04
        assert node.device.held == pytest.approx(0.0, abs=1e-9)


def test_a_missed_period_is_told_as_a_hold_and_answered_without_a_plan(node: Node) -> None:
    node.turns(30)
    steps = node.planner.tip.snapshot().steps
    node.turns(1, 2 * DT_NS)  # two periods are missed: the sample after them is the first that says so
    node.turns(1)
    assert node.planner.tip.snapshot().steps - steps == 4
    assert not node.stopped


def test_a_blocked_tip_stops(steering: Steering, planner_class: Any) -> None:
    node = Node(steering, planner_class, {"plausibility": {"travel": 0.8, "watch_model": False}})
    node.turns(10)
    node.device.blocked = True
    node.planner.tip.set_target(85.0)
    node.turns(150)
    assert node.stopped
    assert "is the tip blocked" in node.planner.status
    assert node.device.held == 0.0


def test_a_device_off_its_model_stops(steering: Steering, planner_class: Any) -> None:
    node = Node(steering, planner_class, {"plausibility": {"model_error_deg": 5.0, "watch_motion": False}})
    node.turns(30)
    for _ in range(100):
        node.device.off_deg = min(node.device.off_deg + 0.5, 25.0)
        node.turns(1)
    assert node.stopped
    assert "off its model" in node.planner.status
    node.turns(60)
    assert node.device.held == 0.0


def test_the_watches_can_be_turned_off(steering: Steering, planner_class: Any) -> None:
    node = Node(steering, planner_class, {"plausibility": {"model_error_deg": 5.0, "watch_model": False}})
    node.turns(30)
    for _ in range(100):
        node.device.off_deg = min(node.device.off_deg + 0.1, 10.0)
        node.turns(1)
    assert not node.stopped, node.planner.status


def test_a_restarted_device_stops_and_a_reset_begins_with_the_contact(node: Node) -> None:
    node.turns(20)
    node.device.session += 1
    node.turns(5)
    assert node.stopped
    assert "restarted" in node.planner.status
    node.turns(60)
    sent = len(node.device.sent)
    node.planner.reset()
    assert node.planner.status == "waits for the device"
    assert not node.stopped
    node.turns(2)
    assert len(node.device.sent) == sent  # two angles are no contact
    node.turns(20)
    assert len(node.device.sent) > sent
    assert not node.stopped


@pytest.mark.parametrize(("listens", "stops"), [((False, True), False), ((True, False), True), ((False, False), True)])
def test_the_newest_reading_says_whether_the_device_listens(
    node: Node, listens: tuple[bool, bool], stops: bool
) -> None:
    """Several may come in one sample; an older one says what was."""
    node.turns(20)

    def twice(found: Reading) -> list[Reading]:
        node.device._sequence += 1
        second = replace(found, sequence=found.sequence + 1, angle_deg=found.angle_deg + 1e-7, listens=listens[1])
        return [replace(found, listens=listens[0]), second]

    node.device.spoilt, greeted = twice, node.device.greeted
    node.turns(1)
    node.device.spoilt = lambda found: [found]
    node.turns(60)
    assert node.stopped == stops
    assert (node.device.greeted > greeted) == stops
    if stops:
        assert "listens to this controller no more" in node.planner.status
        assert node.device.held == 0.0


def test_a_device_that_listens_to_nobody_gets_no_command_any_more(node: Node) -> None:
    node.turns(20)
    node.device.listens = False
    sent = len(node.device.sent)
    node.turns(40)
    assert len(node.device.sent) == sent
    assert node.stopped
    assert node.planner.over
    assert "has not told what it holds" in node.planner.status


def test_without_a_safe_command_a_stop_stays_where_it_is(steering: Steering, planner_class: Any) -> None:
    """After a pause in which the device has moved, that is where it has come to rest."""
    safe, steering.safe_command = steering.safe_command, math.nan
    try:
        node = Node(steering, planner_class)
        node.turns(10).planner.tip.set_target(80.0)
        node.turns(60).planner.stop("somebody")
        assert node.turns(1).planner.status == "safe stop: somebody"
        held = node.turns(60).device.held
        assert held > 3.0
        node.turns(60)
        assert node.device.held == pytest.approx(held, abs=1e-6)
        node.turns(1, round(0.8 * NS))
        assert node.device.held < held - 0.5
        moment = node.clock.ns
        node.turns(150)  # it is left alone until it stands still
        assert rise_after(node, moment) == 0.0
        assert len(node.device.sent) > 200
        node.planner.leave("the node ends")
        node.turns(40)
        node.planner.close()
        assert node.planner.over
        assert node.device.goodbyes == 0
    finally:
        steering.safe_command = safe


def test_whatever_a_reading_holds_the_planner_goes_on_to_the_safe_command(node: Node) -> None:
    node.turns(20)
    node.device.spoilt = lambda found: [replace(found, listens=[1, 2], held="here")]  # type: ignore[arg-type]
    node.turns(100)
    assert node.stopped
    assert "cannot be judged" in node.planner.status
    assert node.device.sent[-1] == 0.0


def test_commands_are_those_of_a_run_sample_by_sample(node: Node) -> None:
    """The steps of a motion, none of which is farther than the rate allows (see `Node.turns`)."""
    node.turns(10).planner.tip.set_target(85.0)
    node.turns(100)
    steps = [abs(b - a) for a, b in pairwise(node.device.sent)]
    assert max(steps) > 0.01
    assert node.planner.newest.source == "mpc"
    assert node.device.angle == pytest.approx(85.0, abs=1.0)

"""The node `tip_planner`: it is imported, started and called in a ROS 2 of one process, beside a simulated device."""

from __future__ import annotations

import importlib
import math
import os
import signal
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
import yaml

from hystmpc.models.load import load_model
from hystmpc.models.prediction.build import predictor_for
from hystmpc.rig.transports.topics import GOODBYE, GREETING, listening
from hystmpc.rig.transports.transport import Admission

from ..codegen.compiled import EXAMPLES
from ..rig.bench_parts import FakeClock
from .interfaces import ROS2
from .ros import Graph, forget, message_class, modules

PACKAGE = ROS2 / "hystmpc_ros"
STAMPED, FLOAT = message_class("hystmpc_msgs/msg/Float64Stamped"), message_class("std_msgs/msg/Float64")
START_DEG, START_MM = 45.0, 2.0
REACH = 0.4  # of builtin:pi at 25 Hz [mm]
GIVEN = {"config": str(EXAMPLES / "tip.yaml")}
DT_NS = 40_000_000


@dataclass
class Device:
    """A catheter behind two topics, with the sessions of a stamped wire; `sent` are the commands it took [mm]."""

    graph: Graph
    clock: FakeClock
    stamped: bool = True
    held: float = START_MM
    admission: Admission = field(default_factory=lambda: Admission(0.3))
    sent: list[float] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    silent: bool = False
    tells: bool = True
    session: int = 77
    sequence: int = 0

    def __post_init__(self) -> None:
        self.predictor = predictor_for(load_model("builtin:tendon-catheter", "conditioned"))
        self.state = self.predictor.initial(START_DEG, START_MM)
        self.angle = float(self.predictor.advance(self.state, START_MM)[0])
        self.graph.readers["tip/command"].append(self.take)

    def take(self, message: Any) -> None:
        if not self.stamped:
            self.accept(message.data)
            return
        come = "planner", message.session, message.sequence, self.clock.ns
        note = message.header.frame_id
        if note == GREETING:
            self.admission.admit("greeting", *come)
        elif note == GOODBYE:
            assert self.admission.admit("goodbye", *come) == ""
        elif self.admission.admit("command", *come) == "":
            self.accept(message.data)
        self.notes.append(note)

    def accept(self, command: float) -> None:
        assert abs(command - self.held) <= REACH + 1e-9
        self.held = command
        self.sent.append(command)

    def period(self) -> None:
        """One sample: the drive is where it was sent, and the angle is published."""
        angle, self.state = self.predictor.advance(self.state, self.held)
        self.angle = float(angle)
        if not self.silent:
            self.publish(self.angle)

    def publish(self, angle: float) -> None:
        self.sequence += 1
        if not self.stamped:
            self.graph.publish("tip/angle_deg", FLOAT(data=angle))
            return
        message = STAMPED(
            session=self.session, sequence=self.sequence, data=angle, held=self.held if self.tells else math.nan
        )
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.clock.ns, 10**9)
        message.header.frame_id = listening(self.admission.session)
        self.graph.publish("tip/angle_deg", message)


@dataclass
class World:
    """A graph with a device and the node, on a clock that obeys."""

    graph: Graph
    clock: FakeClock
    device: Device
    module: Any
    states: list[Any] = field(default_factory=list)
    node: Any = None

    def start(self) -> World:
        self.node = self.module.TipPlanner()
        self.graph.readers["~/state"].append(self.states.append)
        return self

    def turn(self) -> None:
        """One period of the device and of the node."""
        self.clock.ns += DT_NS
        self.device.period()
        for _, call in self.graph.timers:
            call()

    def turns(self, count: int) -> Any:
        for _ in range(count):
            self.turn()
        return self.states[-1]


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[World]:
    """The node's module among modules that stand for ROS."""
    graph, clock = Graph(dict(GIVEN)), FakeClock()
    made: list[World] = []
    for name, module in modules(graph, lambda: made[0].turn()).items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(PACKAGE))
    forget("hystmpc_ros")
    module = importlib.import_module("hystmpc_ros.tip_planner")
    monkeypatch.setattr(module, "MonotonicClock", lambda: clock)
    made.append(World(graph, clock, Device(graph, clock), module))
    yield made[0]
    forget("hystmpc_ros")


def test_it_greets_then_holds_then_reaches_its_target(world: World) -> None:
    state = world.start().turns(10)
    assert world.device.notes[0] == GREETING
    assert abs(world.device.sent[0] - START_MM) < 0.1
    assert (state.source, state.stopped) == ("mpc", False)
    answer = world.graph.call("~/set_target", angle_deg=60.0)
    assert (answer.success, answer.reachable) == (True, True)
    assert answer.low_deg < 60.0 < answer.high_deg
    state = world.turns(150)
    assert state.settled
    assert world.device.angle == pytest.approx(60.0, abs=0.5)
    assert world.graph.timers[0][0] == 0.04


def test_a_target_on_the_topic_is_one_of_the_service(world: World) -> None:
    world.start().turns(10)
    world.graph.publish("~/target", FLOAT(data=55.0))
    assert world.turns(100).reference_deg == pytest.approx(55.0)
    world.graph.publish("~/target", FLOAT(data=math.nan))
    assert world.turns(1).reference_deg == pytest.approx(55.0)
    assert "target nan" in " ".join(world.graph.said)


def test_a_reference_is_followed_as_given(world: World) -> None:
    world.start().turns(10)
    assert world.graph.call("~/set_reference", angles_deg=[46.0, 47.0, 48.0]).success
    assert [round(world.turns(1).reference_deg, 6) for _ in range(5)] == [46.0, 47.0, 48.0, 48.0, 48.0]
    refused = world.graph.call("~/set_reference", angles_deg=[math.inf])
    assert (refused.success, "finite" in refused.message) == (False, True)


def test_a_stop_goes_to_the_safe_command_and_lasts_until_the_reset(world: World) -> None:
    world.start().turns(10)
    assert world.graph.call("~/stop").success
    state = world.turns(60)
    assert (state.stopped, state.source, world.device.held) == (True, "stop", 0.0)
    assert state.status == "safe stop: the service stop"
    sent = len(world.device.sent)
    world.turns(50)
    assert len(world.device.sent) == sent + 50  # its watchdog stays quiet until the reset
    assert "latched" in world.graph.call("~/set_target", angle_deg=60.0).message
    assert world.graph.call("~/reset").success
    world.turns(10)
    assert world.graph.call("~/set_target", angle_deg=60.0).success
    assert world.turns(100).source == "mpc"


def test_nothing_is_sent_before_the_device_answers(world: World) -> None:
    world.device.silent = True
    world.start().turns(20)
    assert world.device.notes == []
    world.device.silent = False
    world.turns(10)
    assert world.device.sent


def test_nothing_is_sent_while_the_drive_still_moves(world: World) -> None:
    world.start()
    for k in range(10):
        world.device.held = START_MM + 0.1 * k
        world.turn()
    assert world.device.sent == []
    world.turns(3)
    assert world.device.sent


def test_a_silence_before_the_first_contact_stops_nothing(world: World) -> None:
    world.device.silent = True
    world.start().turns(2)
    world.clock.ns += 60 * 10**9
    world.turns(1)
    world.device.silent = False
    assert not world.turns(10).stopped
    assert world.device.sent


def test_a_device_that_listens_to_another_gets_no_command(world: World) -> None:
    world.device.admission.admit("greeting", "another", 1, 1, world.clock.ns + 10**12)
    state = world.start().turns(20)
    assert world.device.sent == []
    assert set(world.device.notes) == {GREETING}
    assert state.status == "waits for the device"


def test_a_device_that_listens_no_more_latches_the_stop(world: World) -> None:
    world.start().turns(10)
    world.device.admission = Admission(0.3)
    world.device.notes.clear()
    state = world.turns(2)
    assert state.stopped
    assert "listens to this controller no more" in state.status
    assert set(world.device.notes) == {GREETING}
    world.turns(60)  # the greeting is taken, and it is known again what the device holds
    assert world.device.held == 0.0
    world.graph.call("~/reset")
    assert not world.turns(10).stopped


def test_a_device_that_is_restarted_latches_the_stop(world: World) -> None:
    world.start().turns(10)
    world.device.session += 1
    state = world.turns(3)
    assert state.stopped
    assert "restarted" in state.status


def test_a_dead_sensor_latches_the_stop(world: World) -> None:
    world.start().turns(10)
    world.device.silent = True
    assert world.turns(20).stopped
    assert "sensor dead" in world.states[-1].status
    assert world.turns(60).command == 0.0


def test_angles_that_are_not_plausible_are_not_believed(world: World) -> None:
    world.start().turns(10)
    held = world.device.held
    for angle in (math.nan, 500.0, -10.0):
        world.device.publish(angle)
        world.graph.timers[0][1]()
    assert world.states[-1].measured_deg == pytest.approx(world.device.angle, abs=0.1)
    assert abs(world.device.held - held) < 0.1


def test_a_device_without_sessions_needs_a_start_command(world: World) -> None:
    world.graph.parameters = {**GIVEN, "message": "float64"}
    world.device.stamped = False
    state = world.start().turns(10)
    assert world.device.sent == []
    assert "start_command" in state.status


def test_a_device_without_sessions_is_driven(world: World) -> None:
    world.graph.parameters = {**GIVEN, "message": "float64", "start_command": START_MM}
    world.device.stamped = False
    world.start().turns(10)
    world.graph.call("~/set_target", angle_deg=60.0)
    world.turns(150)
    assert world.device.angle == pytest.approx(60.0, abs=0.5)


def test_its_end_leads_to_the_safe_command_and_says_goodbye(world: World) -> None:
    world.start().turns(10)
    world.node.retire()
    assert world.device.held == 0.0
    assert world.device.notes[-1] == GOODBYE
    assert world.graph.readers["tip/angle_deg"] == []


def test_a_device_that_was_never_commanded_hears_no_goodbye(world: World) -> None:
    world.device.silent = True
    world.start().turns(5)
    world.node.retire()
    assert GOODBYE not in world.device.notes


def test_a_device_that_does_not_tell_what_it_holds_hears_no_goodbye(world: World) -> None:
    world.graph.parameters = {**GIVEN, "start_command": START_MM}
    world.device.tells = False
    world.start().turns(10)
    world.node.retire()
    assert world.device.held == 0.0
    assert GOODBYE not in world.device.notes


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_lead_to_the_safe_command(world: World, number: signal.Signals) -> None:
    before = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}
    turn, count = world.device.period, 0

    def counted() -> None:
        nonlocal count
        count += 1
        if count in (10, 12):  # the second one, on the way, changes nothing
            os.kill(os.getpid(), number)
        turn()

    world.device.period = counted  # type: ignore[method-assign]
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        assert world.module.main() == 0
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
    assert world.device.held == 0.0
    assert world.device.notes[-1] == GOODBYE
    assert world.graph.nodes == []


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"config": ""}, "no parameter config"),
        ({"config": "nowhere.yaml"}, "nowhere.yaml"),
        ({"message": "float32"}, "message"),
        ({"lower_deg": 200.0}, "lower"),
    ],
)
def test_a_start_that_makes_no_sense_ends_with_one_line(world: World, parameters: dict[str, Any], said: str) -> None:
    world.graph.parameters = {**GIVEN, **parameters}
    before = signal.getsignal(signal.SIGTERM)
    try:
        assert world.module.main() == 2
    finally:
        signal.signal(signal.SIGTERM, before)
    assert said in world.graph.said[-1]
    assert "\n" not in world.graph.said[-1]


def test_launch_file_parameters_and_entry_point_are_those_of_the_node(world: World) -> None:
    launch = ElementTree.parse(PACKAGE / "launch" / "tip_planner.launch.xml").getroot()
    node = launch.find("node")
    assert node is not None
    setup = (PACKAGE / "setup.py").read_text(encoding="utf-8")
    assert f"{node.get('exec')} = {node.get('pkg')}.tip_planner:main" in setup
    arguments = {argument.get("name") for argument in launch.findall("arg")}
    used = {value for part in node.iter() for value in part.attrib.values() if value.startswith("$(var ")}
    assert {value[len("$(var ") : -1] for value in used} == arguments
    declared = world.module.PARAMETERS
    assert {part.get("name") for part in node.findall("param")} - {None} <= declared.keys()
    config = yaml.safe_load((PACKAGE / "config" / "tip_planner.yaml").read_text(encoding="utf-8"))
    given = config[str(node.get("name"))]["ros__parameters"]
    found = {name for name, value in declared.items() if value != value}
    assert given.keys() == declared.keys() - {"config"} - found
    assert {name: declared[name] for name in given} == given
    readme = (PACKAGE / "README.md").read_text(encoding="utf-8")
    assert [name for name in declared if f"`{name}`" not in readme] == []

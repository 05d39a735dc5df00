"""The node `tip_planner` with a controller of two axes, in a ROS 2 of one process, beside a simulated device."""

from __future__ import annotations

import math
import os
import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.rig.axes import Vec
from hystmpc.rig.transports.topics import GOODBYE, GREETING, listening
from hystmpc.rig.transports.transport import Admission
from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
from hystmpc.sim.two_axes.plant import TwoAxisPlant

from ..models.two_axis_examples import DT, RATE, REACH, two_axes
from ..rig.bench_parts import FakeClock
from .ros import Graph, message_class
from .test_planner import World, world

__all__ = ["world"]  # the fixture
PAIR, ARRAY = message_class("hystmpc_msgs/msg/Float64PairStamped"), message_class("std_msgs/msg/Float64MultiArray")
MODEL = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)))
SAFE = tuple(MODEL.commands((0.0, 0.0)).tolist())
START, TARGET = (0.5, -0.5), (12.0, -6.0)


@dataclass
class Pullers:
    """A device of two axes behind two topics, with the sessions of a stamped wire; `sent` are the commands it took."""

    graph: Graph
    clock: FakeClock
    stamped: bool = True
    tells: bool = True
    silent: bool = False
    session: int = 77
    sequence: int = 0
    off_deg: Vec = field(default_factory=lambda: np.zeros(2))
    admission: Admission = field(default_factory=lambda: Admission(0.3))
    sent: list[tuple[float, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.plant = TwoAxisPlant(MODEL, TwoAxisPlantSettings(simulator="model", noise_deg=0.01), 3)
        self.held = START
        for _ in range(50):
            self.angles = self.plant.apply(np.array(START))
        self.graph.readers["tip/command"].append(self.take)

    def take(self, message: Any) -> None:
        if not self.stamped:
            self.accept(tuple(message.data))
            return
        come = "planner", message.session, message.sequence, self.clock.ns
        note = message.header.frame_id
        if note == GREETING:
            self.admission.admit("greeting", *come)
        elif note == GOODBYE:
            assert self.admission.admit("goodbye", *come) == ""
        elif self.admission.admit("command", *come) == "":
            self.accept(tuple(message.data))
        self.notes.append(note)

    def accept(self, commands: tuple[float, ...]) -> None:
        """Every command lies within value and rate of its axis."""
        for one, before in zip(commands, self.held, strict=True):
            assert abs(one) <= REACH
            assert abs(one - before) <= RATE * DT + 1e-9
        self.held = (commands[0], commands[1])
        self.sent.append(self.held)

    def period(self) -> None:
        """One sample: the drives are where they were sent, and the angles are published."""
        self.angles = self.plant.apply(np.array(self.held))
        if not self.silent:
            self.publish(self.angles + self.off_deg)

    def publish(self, angles: Any) -> None:
        self.sequence += 1
        data = list(map(float, angles))
        if not self.stamped:
            self.graph.publish("tip/angle_deg", ARRAY(data=data))
            return
        held = list(self.held) if self.tells else [math.nan, math.nan]
        message = PAIR(session=self.session, sequence=self.sequence, data=data, held=held)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.clock.ns, 10**9)
        message.header.frame_id = listening(self.admission.session)
        self.graph.publish("tip/angle_deg", message)


def config_in(folder: Path, model: TwoAxisModel = MODEL, safe: str = "0.0") -> str:
    """The file of a controller in a folder."""
    model.save(folder / "both.yaml")
    text = f"model: both.yaml\ncontroller: {{kind: linearised_mpc, ladder: {{safe_command: {safe}}}}}\n"
    (folder / "tip.yaml").write_text(text, encoding="utf-8")
    return str(folder / "tip.yaml")


@pytest.fixture
def plane(world: World, tmp_path: Path) -> World:
    """The node beside a device of two axes, in the place of that of one."""
    world.graph.parameters = {"config": config_in(tmp_path)}
    world.graph.readers["tip/command"].clear()
    device: Any = Pullers(world.graph, world.clock)
    world.device = device
    return world


def test_it_greets_then_holds_then_reaches_its_target(plane: World) -> None:
    state = plane.start().turns(10)
    assert plane.device.notes[0] == GREETING
    assert plane.device.sent[0] == pytest.approx(START, abs=0.1)
    assert (state.source, state.stopped) == ("mpc", False)
    answer = plane.graph.call("~/set_target", angle_deg=list(TARGET))
    assert (answer.success, answer.reachable) == (True, True)
    assert answer.nearest_deg == pytest.approx(TARGET)
    state = plane.turns(150)
    assert state.settled
    assert plane.device.angles == pytest.approx(TARGET, abs=0.5)
    assert state.measured_deg == pytest.approx(plane.device.angles, abs=0.1)
    assert state.command == pytest.approx(plane.device.held)
    assert state.error_deg == pytest.approx(np.array(state.reference_deg) - state.measured_deg)


def test_a_target_out_of_reach_says_what_is_nearest(plane: World) -> None:
    plane.start().turns(10)
    answer = plane.graph.call("~/set_target", angle_deg=[80.0, 0.0])
    assert (answer.success, answer.reachable) == (True, False)
    assert "beyond" in answer.message
    assert 0.0 < answer.nearest_deg[0] < 80.0


def test_a_target_on_the_topic_is_one_of_the_service(plane: World) -> None:
    plane.start().turns(10)
    plane.graph.publish("~/target", ARRAY(data=list(TARGET)))
    assert plane.turns(100).reference_deg == pytest.approx(TARGET)
    for odd in ([1.0], [], [1.0, math.nan], [1.0, 2.0, 3.0]):
        said = len(plane.graph.said)
        plane.graph.publish("~/target", ARRAY(data=odd))
        assert plane.turns(1).reference_deg == pytest.approx(TARGET)
        assert plane.graph.said[said].startswith("target ")


def test_a_reference_is_followed_as_given(plane: World) -> None:
    plane.start().turns(10)
    x, y = [4.0, 4.5, 5.0], [-4.0, -4.5, -5.0]
    assert plane.graph.call("~/set_reference", x_deg=x, y_deg=y).success
    followed = [[round(one, 6) for one in plane.turns(1).reference_deg] for _ in range(5)]
    assert followed == [*map(list, zip(x, y, strict=True)), [5.0, -5.0], [5.0, -5.0]]
    for wrong in ({"x_deg": x, "y_deg": [0.0]}, {"x_deg": [math.inf], "y_deg": [0.0]}, {"x_deg": [], "y_deg": []}):
        refused = plane.graph.call("~/set_reference", **wrong)
        assert not refused.success
        assert refused.message
        assert "\n" not in refused.message


def test_a_stop_goes_to_the_safe_commands_and_lasts_until_the_reset(plane: World) -> None:
    plane.start().turns(10)
    assert plane.graph.call("~/stop").success
    state = plane.turns(60)
    assert (state.stopped, state.source) == (True, "stop")
    assert plane.device.held == pytest.approx(SAFE, abs=1e-9)
    assert state.status == "safe stop: the service stop"
    assert "latched" in plane.graph.call("~/set_target", angle_deg=list(TARGET)).message
    assert plane.graph.call("~/reset").success
    plane.turns(10)
    assert plane.graph.call("~/set_target", angle_deg=list(TARGET)).success
    assert plane.turns(100).source == "mpc"


def test_without_a_safe_command_a_stop_rests_in_place(plane: World, tmp_path: Path) -> None:
    plane.graph.parameters = {"config": config_in(tmp_path, safe="null")}
    plane.start().turns(10)
    plane.graph.call("~/set_target", angle_deg=list(TARGET))
    plane.turns(40)
    plane.graph.call("~/stop")
    plane.turns(30)
    held = plane.device.held
    assert plane.turns(20).stopped
    assert plane.device.held == held
    assert held != pytest.approx(SAFE, abs=0.2)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_dead_sensor_of_one_axis_latches_the_stop_of_both(axis: int, plane: World) -> None:
    plane.start().turns(10)
    plane.device.off_deg[axis] = math.nan
    assert plane.turns(20).stopped
    assert f"{'xy'[axis]}: sensor dead" in plane.states[-1].status
    plane.turns(60)
    assert plane.device.held == pytest.approx(SAFE, abs=1e-9)
    assert math.isfinite(plane.states[-1].measured_deg[axis])


def test_a_silent_device_latches_the_stop_and_the_node_goes_on(plane: World) -> None:
    plane.start().turns(10)
    before = plane.states[-1].measured_deg
    plane.device.silent = True
    state = plane.turns(20)
    assert state.stopped
    assert "sensor dead" in state.status
    assert state.measured_deg == pytest.approx(before, abs=0.1)
    plane.turns(60)
    assert plane.device.held == pytest.approx(SAFE, abs=1e-9)


def test_a_device_off_its_model_latches_the_stop(plane: World) -> None:
    plane.graph.parameters = {**plane.graph.parameters, "model_error_deg": 5.0, "watch_motion": False}
    plane.start().turns(30)
    for _ in range(100):
        plane.device.off_deg = np.minimum(plane.device.off_deg + (0.0, 0.3), 20.0)
        plane.turn()
    assert plane.states[-1].stopped
    assert "off its model" in plane.node.planner.status


def test_a_device_that_is_restarted_or_listens_no_more_latches_the_stop(plane: World) -> None:
    plane.start().turns(10)
    plane.device.session += 1
    assert plane.turns(3).stopped
    assert "restarted" in plane.states[-1].status
    plane.turns(60)
    plane.graph.call("~/reset")
    assert not plane.turns(10).stopped
    plane.device.admission = Admission(0.3)
    assert plane.turns(2).stopped
    assert "listens to this controller no more" in plane.states[-1].status


def test_messages_of_another_count_move_nothing(plane: World) -> None:
    """Float64MultiArray may have any length."""
    plane.graph.parameters = {**plane.graph.parameters, "message": "float64", "start_command": list(START)}
    plane.device.stamped, plane.device.silent = False, True
    plane.start()
    for odd in ([], [3.0], [3.0, -3.0, 0.0]):
        for _ in range(5):
            plane.graph.publish("tip/angle_deg", ARRAY(data=odd))
            plane.turn()
    assert plane.device.sent == []
    plane.device.silent = False
    plane.turns(10)
    assert plane.device.sent


@pytest.mark.parametrize("given_", [{}, {"start_command": list(START)}])
def test_a_device_without_sessions_needs_a_start_command(given_: dict[str, Any], plane: World) -> None:
    plane.graph.parameters = {**plane.graph.parameters, "message": "float64", **given_}
    plane.device.stamped = False
    state = plane.start().turns(10)
    if not given_:
        assert plane.device.sent == []
        assert "start_command" in state.status
        return
    plane.graph.call("~/set_target", angle_deg=list(TARGET))
    plane.turns(150)
    assert plane.device.angles == pytest.approx(TARGET, abs=0.5)


@given(at=st.integers(0, 60), pause=st.floats(0.13, 5.0), target=st.tuples(st.floats(-15, 15), st.floats(-15, 15)))
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_after_any_pause_the_commands_stay_within_their_limits(
    plane: World, at: int, pause: float, target: tuple[float, float]
) -> None:
    """`Pullers.accept` asserts value and rate of each command that it takes."""
    plane.graph.timers.clear()
    plane.graph.readers["tip/angle_deg"].clear()
    plane.graph.readers["tip/command"].clear()
    plane.device = Pullers(plane.graph, plane.clock)  # type: ignore[assignment]
    plane.start().turns(10)
    plane.graph.call("~/set_target", angle_deg=list(target))
    for _ in range(at):
        plane.turn()
    plane.clock.ns += round(1e9 * pause)
    plane.turns(60)
    assert plane.device.sent


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_lead_to_the_safe_commands(plane: World, number: signal.Signals) -> None:
    before = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}
    turn, count = plane.device.period, 0

    def counted() -> None:
        nonlocal count
        count += 1
        if count == 10:
            os.kill(os.getpid(), number)
        turn()

    plane.device.period = counted  # type: ignore[method-assign]
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        assert plane.module.main() == 0
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
    assert plane.device.held == pytest.approx(SAFE, abs=1e-9)
    assert plane.device.notes[-1] == GOODBYE


@pytest.mark.parametrize(
    ("parameters", "said"), [({"lower_deg": 200.0}, "lower"), ({"start_command": [9.0, 0.0]}, "start_command 9.0")]
)
def test_parameters_that_make_no_sense_end_with_one_line(plane: World, parameters: dict[str, Any], said: str) -> None:
    plane.graph.parameters = {**plane.graph.parameters, **parameters}
    before = signal.getsignal(signal.SIGTERM)
    try:
        assert plane.module.main() == 2
    finally:
        signal.signal(signal.SIGTERM, before)
    assert said in plane.graph.said[-1]
    assert "\n" not in plane.graph.said[-1]


def test_a_model_of_tendons_is_refused_in_one_line(plane: World, tmp_path: Path) -> None:
    tendons = two_axes().with_tendons([0, 90, 180, 270], pretension=1.0, limits=[(0.2, 4.0)] * 4, rates_per_s=[8.0] * 4)
    plane.graph.parameters = {"config": config_in(tmp_path, tendons)}
    before = signal.getsignal(signal.SIGTERM)
    try:
        assert plane.module.main() == 2
    finally:
        signal.signal(signal.SIGTERM, before)
    assert "a model of 4 commands, expected two" in plane.graph.said[-1]


def test_the_parameter_file_of_two_axes_holds_what_differs(plane: World) -> None:
    import yaml

    from .test_planner import PACKAGE

    config = yaml.safe_load((PACKAGE / "config" / "two_axes.yaml").read_text(encoding="utf-8"))
    given_ = config["tip_planner"]["ros__parameters"]
    known = plane.module.PARAMETERS | plane.module.OF_TWO_AXES
    assert {name: known[name] for name in given_} == given_
    assert "config/two_axes.yaml" in (PACKAGE / "setup.py").read_text(encoding="utf-8")

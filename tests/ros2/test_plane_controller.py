"""The ros2_control plugin of two axes sends what the Python controller sends, and keeps the laws of its lifecycle."""

from __future__ import annotations

import ctypes
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl import TipController
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
from hystmpc.sim.two_axes.plant import TwoAxisPlant

from ..codegen.compiled import compile_c, compilers, tried
from ..ctrl.test_two_axes import TENDONS
from ..models.two_axis_examples import DT, RATE, REACH, SHARED, two_axes
from .plugin import ERROR, PACKAGE, SUCCESS, PlaneManager, compiled, written

MODEL = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)), SHARED)
START = (0.5, -0.5)
AT_REST = tuple(float(y) for y in MODEL.run([START] * 2, (0.0, 0.0))[0])
SAFE = MODEL.commands((0.0, 0.0))
ROUNDING = 1e-9  # of units [mm]
ANYTHING = st.floats(allow_nan=True, allow_infinity=True, width=64)


def settings_in(folder: Path, model: TwoAxisModel) -> dict[str, Any]:
    """Settings of a controller of a model."""
    law = {"kind": "linearised_mpc", "adaptation": None, "ladder": {"safe_command": 0.0}}
    return {"model": str(model.save(folder / "both.yaml")), "controller": law}


@pytest.fixture(scope="module")
def tip(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return settings_in(tmp_path_factory.mktemp("model"), MODEL)


@pytest.fixture(scope="module")
def library(tip: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The plugin with that controller."""
    return compiled(tmp_path_factory.mktemp("plugin"), tip)


@pytest.fixture
def running(library: ctypes.CDLL) -> PlaneManager:
    """Active, at rest."""
    manager = PlaneManager(library, 2)
    assert manager.begin(AT_REST, START) == SUCCESS, manager.said
    return manager


def within(u: Any, last: Any) -> bool:
    """Whether commands are within their limits on value and rate."""
    return all(
        abs(one) <= REACH + ROUNDING and abs(one - before) <= RATE * DT + ROUNDING
        for one, before in zip(u, last, strict=True)
    )


def test_commands_are_those_of_python(library: ctypes.CDLL, tip: dict[str, Any]) -> None:
    require_same_commands(MODEL, tip, library)


@pytest.mark.slow
def test_commands_of_four_tendons_are_those_of_python(tmp_path: Path) -> None:
    settings = settings_in(tmp_path, TENDONS)
    require_same_commands(TENDONS, settings, compiled(tmp_path, settings))


def require_same_commands(model: TwoAxisModel, settings: dict[str, Any], library: ctypes.CDLL) -> None:
    """Each in a loop of its own around a simulated device, with noise, lost measurements and targets."""
    random = np.random.default_rng(3)
    devices = [TwoAxisPlant(model, TwoAxisPlantSettings(simulator="model")) for _ in range(2)]
    python, plugin = TipController.from_config(settings), PlaneManager(library, len(model.mix[0]))
    start, angles = np.array(model.rest_commands), [device.true_angle for device in devices]
    python.reset(angles[0], start)
    assert plugin.begin(angles[1], start) == SUCCESS, plugin.said
    sent = np.empty((200, 2, start.size))
    for k in range(len(sent)):
        if k % 50 == 10:
            wanted = random.uniform(-10.0, 10.0, 2)
            python.set_reference([wanted])
            plugin.lead(wanted)
        noise = random.normal(0.0, 0.1, 2)
        noise[: 1 + k % 2] += math.nan if k % 40 in (20, 21, 22) else 0.0
        sent[k] = python.step(angles[0] + noise).u, plugin.advance(angles[1] + noise)
        angles = [device.apply(u) for device, u in zip(devices, sent[k], strict=True)]
    assert np.ptp(sent[:, 0], axis=0).min() > 0.5
    assert np.max(np.abs(sent[:, 0] - sent[:, 1])) <= 1e-6


def test_it_claims_what_its_parameters_name(library: ctypes.CDLL, running: PlaneManager) -> None:
    assert running.call("names").decode().split() == [
        "drive_0/position", "drive_1/position", "tip_x/position", "tip_y/position",
        "tip_controller/tip_x/position", "tip_controller/tip_y/position",
    ]  # fmt: skip
    plain = PlaneManager(library, 2, lists={"command_interfaces": []})
    assert plain.begin(AT_REST, START) == SUCCESS
    assert plain.call("names").decode().split()[:2] == ["tip_x/position", "tip_y/position"]


@pytest.mark.parametrize(
    ("lists", "said"),
    [
        ({"joints": []}, "got 0 names in the parameter joints"),
        ({"joints": ["tip"]}, "got 1 names in the parameter joints"),
        ({"state_interfaces": ["tip/position"]}, "got 1 state_interfaces and 2 command_interfaces, expected 2 and 2"),
        ({"command_interfaces": ["a/position"]}, "got 2 state_interfaces and 1 command_interfaces"),
        ({"start_commands": [1.0]}, "got 1 start_commands, expected 2"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(library: ctypes.CDLL, lists: dict[str, Any], said: str) -> None:
    manager = PlaneManager(library, 2, lists=lists)
    assert manager.call("configure") == ERROR
    assert said in manager.said


def test_drives_without_a_command_need_one_to_start_at(library: ctypes.CDLL) -> None:
    assert PlaneManager(library, 2).begin(AT_REST, (math.nan, START[1])) == ERROR
    manager = PlaneManager(library, 2, lists={"start_commands": list(START)})
    assert manager.begin(AT_REST, (math.nan, START[1])) == SUCCESS
    assert within(manager.advance(AT_REST), START)


@pytest.mark.parametrize("angles", [(math.nan, 0.0), (0.0, math.inf), (AT_REST[0], AT_REST[1] + 170.0)])
def test_an_angle_of_one_axis_that_makes_no_sense_stops_the_activation(
    library: ctypes.CDLL, angles: tuple[float, float]
) -> None:
    manager = PlaneManager(library, 2)
    assert manager.begin(angles, START) == ERROR
    assert "cannot start" in manager.said
    assert manager.held == pytest.approx(START)


def test_without_a_target_it_stays_where_it_started(running: PlaneManager) -> None:
    for _ in range(20):
        assert running.advance(AT_REST) == pytest.approx(START, abs=0.1)


@given(st.lists(st.tuples(st.tuples(ANYTHING, ANYTHING), st.tuples(ANYTHING, ANYTHING), st.booleans()), max_size=20))
def test_any_input_is_answered_within_the_limits(library: ctypes.CDLL, inputs: list[tuple[Any, Any, bool]]) -> None:
    manager = PlaneManager(library, 2)
    assert manager.begin(AT_REST, START) == SUCCESS
    last: Any = START
    for angles, target, chained in inputs:
        assert manager.call("chain", chained) == 1
        if chained:
            for i, angle in enumerate(target):
                manager.call("refer_at", i, angle)
        else:
            manager.lead(target)
        command = manager.advance(angles)
        assert within(command, last)
        last = command


@pytest.mark.parametrize("axis", [0, 1])
def test_another_writer_at_one_drive_is_found_and_gone_on_from(axis: int, running: PlaneManager) -> None:
    """In the sample in which it is found nothing is sent to either drive."""
    running.lead((12.0, 6.0))
    for _ in range(3):
        running.advance(AT_REST)
    found = running.held
    found[axis] = 0.1
    running.put(AT_REST, found)
    assert running.advance(AT_REST) == pytest.approx(found)
    assert within(running.advance(AT_REST), found)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("odd", [math.nan, math.inf, -0.004])
def test_nothing_is_written_where_it_is_not_known_what_one_drive_holds(
    axis: int, odd: float, running: PlaneManager
) -> None:
    running.lead((12.0, 6.0))
    running.advance(AT_REST)
    found = running.held
    found[axis] = 1000.0 * odd
    running.put(AT_REST, found)
    assert [running.call("update") for _ in range(2)] == [-1, -1]
    assert running.held == pytest.approx(found, nan_ok=True)
    assert running.call("deactivate") == SUCCESS
    assert running.held == pytest.approx(found, nan_ok=True)
    assert running.call("activate") == ERROR


def test_a_stop_ramps_both_to_the_safe_commands_and_an_activation_releases_it(running: PlaneManager) -> None:
    assert running.call("stop") == 1
    running.lead((12.0, 6.0))
    last: Any = START
    for _ in range(10):
        command = running.advance(AT_REST)
        assert within(command, last)
        last = command
    assert last == pytest.approx(SAFE, abs=1e-9)
    assert running.call("deactivate") == SUCCESS
    running.put(AT_REST, START)
    assert running.call("activate") == SUCCESS
    running.lead((12.0, 6.0))
    assert running.advance(AT_REST) != pytest.approx(START, abs=1e-3)


@pytest.mark.parametrize("at_once", [False, True])
def test_a_deactivation_goes_towards_the_safe_commands(library: ctypes.CDLL, at_once: bool) -> None:
    manager = PlaneManager(library, 2, deactivate_at_once=at_once)
    assert manager.begin(AT_REST, START) == SUCCESS
    manager.lead((12.0, 6.0))
    last = [manager.advance(AT_REST) for _ in range(5)][-1]
    assert manager.call("deactivate") == SUCCESS
    if at_once:
        assert manager.held == pytest.approx(SAFE, abs=1e-9)
    else:
        assert within(manager.held, last)
        assert manager.held != pytest.approx(last, abs=1e-3)


def test_a_controller_before_it_leads_by_the_reference_interfaces(library: ctypes.CDLL, running: PlaneManager) -> None:
    topic = PlaneManager(library, 2)
    assert topic.begin(AT_REST, START) == SUCCESS
    topic.lead((12.0, 6.0))
    assert running.call("chain", 1) == 1
    running.lead((-12.0, 0.0))  # nobody listens to the topic meanwhile
    for i, angle in enumerate((12.0, 6.0)):
        running.call("refer_at", i, math.radians(angle))
    for _ in range(5):
        assert running.advance(AT_REST) == pytest.approx(topic.advance(AT_REST), abs=1e-9)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_target_of_another_length_is_refused_and_moves_nothing(count: int, running: PlaneManager) -> None:
    running.lead([10.0] * count)
    assert f"got {count} angles on ~/target, expected x and y" in running.said
    for _ in range(5):
        assert running.advance(AT_REST) == pytest.approx(START, abs=0.1)


def test_the_example_names_parameters_that_are_declared() -> None:
    source = (PACKAGE / "src" / "controller.cpp").read_text(encoding="utf-8")
    config = yaml.safe_load((PACKAGE / "config" / "two_axes.yaml").read_text(encoding="utf-8"))
    given_ = config["tip_controller"]["ros__parameters"].keys() - {"update_rate"}
    assert given_ <= set(re.findall(r'auto_declare<[\w:]+>\("(\w+)"', source))


@pytest.mark.slow
@pytest.mark.parametrize("compiler", compilers("c++")[-1:], ids=lambda command: Path(command[-2 % len(command)]).name)
def test_another_compiler_takes_it_without_a_warning(compiler: list[str], tip: dict[str, Any], tmp_path: Path) -> None:
    """In single precision; the library of these tests is double, and takes no warning either."""
    assert tried([*compiler, *written(tmp_path, True, tip), "-O1", "-c"], tmp_path) == ""


@pytest.mark.slow
def test_it_runs_clean_under_the_sanitizers(tip: dict[str, Any], tmp_path: Path) -> None:
    arguments, run = written(tmp_path, tip=tip), tmp_path / "run.cpp"
    run.write_text(_RUN, encoding="utf-8")
    checks = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "run.cpp", "-o", "run"]
    compile_c([*arguments, *checks], tmp_path, "c++")
    assert tried([str(tmp_path / "run")], tmp_path) == ""


_RUN = """
struct Manager;
extern "C" {
Manager * manager_new(unsigned int);
void manager_delete(Manager *);
void set_texts(Manager *, const char *, const char *);
int configure(Manager *);
int activate(Manager *);
int deactivate(Manager *);
int cleanup(Manager *);
int targets(Manager *, const double *, int);
void hold_at(Manager *, int, double);
void measure_at(Manager *, int, double);
long update(Manager *);
}
int main() {
    Manager * m = manager_new(25);
    set_texts(m, "joints", "tip_x tip_y");
    for (int life = 0; life < 3; life++) {
        for (int k = 0; k < 2; k++) {
            measure_at(m, k, 0.0);
            hold_at(m, k, 0.0);
        }
        if (configure(m) || activate(m)) return 1;
        for (int k = 0; k < 300; k++) {
            const double wanted[] = {0.001 * k, -0.0005 * k, 1.0};
            if (k % 40 == 0) targets(m, wanted, k % 80 ? 2 : 3);
            measure_at(m, 0, k % 17 ? 0.0005 * k : __builtin_nan(""));
            measure_at(m, 1, -0.0002 * k);
            if (update(m) != 0) return 2;
        }
        if (deactivate(m) || cleanup(m)) return 3;
    }
    manager_delete(m);
    return 0;
}
"""

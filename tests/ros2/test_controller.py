"""The ros2_control plugin sends what the Python controller sends, and keeps the laws of its lifecycle."""

from __future__ import annotations

import ctypes
import math
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl import TipController
from hystmpc.models.load import load_model
from hystmpc.models.prediction.build import predictor_for

from ..codegen.compiled import EXAMPLES, compile_c, compilers, tried
from .plugin import ERROR, PACKAGE, SUCCESS, TIP, Manager, compiled, written

START_DEG, START_MM = 45.0, 2.0
LOWER, UPPER, REACH = 0.0, 6.0, 0.4  # of builtin:pi at 25 Hz [mm]
ROUNDING = 1e-9  # of units [mm]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The plugin with the controller of examples/tip.yaml."""
    return compiled(tmp_path_factory.mktemp("plugin"))


@pytest.fixture
def running(library: ctypes.CDLL) -> Manager:
    """Active, at rest at 45 deg under 2 mm."""
    manager = Manager(library)
    assert manager.start(START_DEG, START_MM) == SUCCESS, manager.said
    return manager


@pytest.mark.slow
def test_commands_are_those_of_python(library: ctypes.CDLL) -> None:
    """Each in a loop of its own around a simulated catheter, with noise, lost measurements and targets."""
    random, device = np.random.default_rng(3), predictor_for(load_model("builtin:tendon-catheter", "conditioned"))
    python, plugin = TipController.from_config(EXAMPLES / TIP), Manager(library)
    states = [device.initial(START_DEG, START_MM)] * 2
    angles = [float(device.advance(states[0], START_MM)[0])] * 2
    python.reset(angles[0], START_MM)
    assert plugin.start(angles[1], START_MM) == SUCCESS, plugin.said
    sent = np.empty((500, 2))
    for k in range(len(sent)):
        if k % 50 == 10:
            wanted = random.uniform(35.0, 80.0)
            python.set_reference([wanted])
            plugin.target(wanted)
        noise = math.nan if k % 40 in (20, 21, 22) else random.normal(0.0, 0.1)
        sent[k] = python.step(angles[0] + noise).u, plugin.step(angles[1] + noise)
        for i in range(2):
            angle, states[i] = device.advance(states[i], float(sent[k, i]))
            angles[i] = float(angle)
    assert np.ptp(sent[:, 0]) > 2.0
    assert np.max(np.abs(sent[:, 0] - sent[:, 1])) <= 1e-6


def test_it_claims_what_its_parameters_name(library: ctypes.CDLL, running: Manager) -> None:
    assert running.call("names").decode().split() == ["drive/position", "tip/position", "tip_controller/tip/position"]
    plain = Manager(library, command_interface="", command_scale=1.0)
    plain.start(START_DEG, 1000.0 * START_MM)
    assert plain.call("names").decode().split()[0] == "tip/position"


@pytest.mark.parametrize("rate_hz", [0, 1, 24, 26, 100])
def test_another_update_rate_is_refused(library: ctypes.CDLL, rate_hz: int) -> None:
    manager = Manager(library, rate_hz=rate_hz)
    assert manager.call("configure") == ERROR
    assert "expected 25.0" in manager.said


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"joint": ""}, "no parameter joint"),
        ({"angle_unit": "grad"}, "expected rad or deg"),
        ({"command_scale": 0.0}, "command_scale of 0"),
        ({"command_scale": math.nan}, "command_scale of 0 or no number"),
        ({"least_angle": 1.0, "greatest_angle": 1.0}, "least_angle that is not below"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(
    library: ctypes.CDLL, parameters: dict[str, str | float], said: str
) -> None:
    manager = Manager(library, **parameters)
    assert manager.call("configure") == ERROR
    assert said in manager.said


def test_degrees_are_taken_as_degrees(library: ctypes.CDLL, running: Manager) -> None:
    degrees = Manager(library, angle_unit="deg")
    degrees.call("measure", START_DEG)
    degrees.call("hold", START_MM / 1000.0)
    assert degrees.call("configure") == degrees.call("activate") == SUCCESS
    assert degrees.call("target", 60.0) == 1
    running.target(60.0)
    for _ in range(5):
        assert degrees.call("update") == 0
        assert running.step(START_DEG) == pytest.approx(degrees.held_mm, abs=1e-9)


def test_a_drive_without_a_command_needs_one_to_start_at(library: ctypes.CDLL) -> None:
    assert Manager(library).start(START_DEG, math.nan) == ERROR
    manager = Manager(library, start_command=START_MM)
    assert manager.start(START_DEG, math.nan) == SUCCESS
    assert abs(manager.step(START_DEG) - START_MM) <= REACH + ROUNDING


@pytest.mark.parametrize("angle", [math.nan, math.inf, 170.0])
def test_an_angle_that_makes_no_sense_stops_the_activation(library: ctypes.CDLL, angle: float) -> None:
    manager = Manager(library)
    assert manager.start(angle, START_MM) == ERROR
    assert "cannot start" in manager.said
    assert manager.held_mm == START_MM


def test_commands_at_a_limit_survive_the_conversion_of_units(library: ctypes.CDLL) -> None:
    assert Manager(library).start(80.0, UPPER * (1.0 + 1e-12)) == SUCCESS
    assert Manager(library).start(80.0, UPPER * (1.0 + 1e-4)) == ERROR


def test_without_a_target_it_stays_where_it_started(running: Manager) -> None:
    sent = [running.step(START_DEG) for _ in range(20)]
    assert max(abs(command - START_MM) for command in sent) < 0.1


def test_lost_measurements_cause_no_jump(running: Manager) -> None:
    running.target(60.0)
    last = running.held_mm
    for angle in [*np.linspace(START_DEG, 50.0, 10).tolist(), *[math.nan] * 30, *[50.0] * 5]:
        command = running.step(angle)
        assert LOWER - ROUNDING <= command <= UPPER + ROUNDING
        assert abs(command - last) <= REACH + ROUNDING
        last = command


ANYTHING = st.floats(allow_nan=True, allow_infinity=True, width=64)


@given(st.lists(st.tuples(ANYTHING, ANYTHING, st.booleans()), min_size=1, max_size=30))
def test_any_input_is_answered_within_the_limits(library: ctypes.CDLL, inputs: list[tuple[float, float, bool]]) -> None:
    manager = Manager(library)
    assert manager.start(START_DEG, START_MM) == SUCCESS
    last = START_MM
    for angle, target, chained in inputs:
        assert manager.call("chain", chained) == 1
        manager.call("refer" if chained else "target", target)
        manager.call("measure", angle)
        assert manager.call("update") == 0
        command = manager.held_mm
        assert LOWER - ROUNDING <= command <= UPPER + ROUNDING
        assert abs(command - last) <= REACH + ROUNDING
        last = command


ANGLES = st.one_of(ANYTHING, st.floats(0.5, 1.4))
HELD = st.one_of(ANYTHING, st.floats(LOWER / 1000.0, UPPER / 1000.0))
PERIODS = st.one_of(ANYTHING, st.floats(0.0, 0.5), *3 * [st.just(0.04)])
EVENTS = st.lists(
    st.tuples(ANGLES, st.none() | HELD, PERIODS, st.sampled_from(["", "", "", "", "stop", "again"])),
    min_size=1,
    max_size=30,
)


@given(EVENTS)
def test_commands_start_from_what_stands_at_the_interface(
    library: ctypes.CDLL, events: list[tuple[float, float | None, float, str]]
) -> None:
    """Pauses, another writer, numbers that are none, stops and activations: each command is near what was found."""
    manager = Manager(library)
    assert manager.start(START_DEG, START_MM) == SUCCESS
    fresh = True  # since the activation nothing has been written: a drive that says nothing holds what it said then
    for angle, other, period, event in events:
        manager.call("measure", angle)
        if other is not None:
            manager.call("hold", other)
        if event == "again":
            assert manager.call("deactivate") == SUCCESS
            if manager.call("activate") != SUCCESS:
                manager.hold(START_DEG, START_MM)
                assert manager.call("activate") == SUCCESS
            fresh = True
        elif event:
            manager.call(event)
        found = manager.held_mm
        known = LOWER - ROUNDING <= found <= UPPER + ROUNDING or (fresh and math.isnan(found))
        fresh = False
        assert manager.call("update_after", period) == (0 if known or 0.0 < period < 0.02 else -1)
        if not known:
            assert manager.held_mm == found or math.isnan(found)
            continue
        if math.isnan(manager.held_mm):  # nothing was written
            continue
        assert LOWER - ROUNDING <= manager.held_mm <= UPPER + ROUNDING
        assert math.isnan(found) or abs(manager.held_mm - found) <= REACH + ROUNDING


def test_another_writer_is_found_and_gone_on_from(running: Manager) -> None:
    """In the sample in which it is found nothing is sent, as by the gate of a run."""
    running.target(80.0)
    for _ in range(3):
        running.step(START_DEG)
    running.call("hold", 0.0005)
    assert running.step(START_DEG) == pytest.approx(0.5)
    assert running.step(START_DEG) == pytest.approx(0.5 + REACH)


@pytest.mark.parametrize(("pause_s", "moves"), [(0.04, True), (0.1, True), (0.16, False), (3.0, False), (1e9, False)])
def test_after_a_pause_nothing_is_sent_at_once(running: Manager, pause_s: float, moves: bool) -> None:
    running.target(80.0)
    last = [running.step(START_DEG) for _ in range(3)][-1]
    assert running.step(START_DEG, pause_s) == pytest.approx(last + REACH if moves else last)
    assert running.step(START_DEG) > last


def test_updates_that_come_too_fast_make_no_command_until_a_sample_has_passed(running: Manager) -> None:
    running.target(80.0)
    last = [running.step(START_DEG) for _ in range(3)][-1]
    assert [running.step(START_DEG, 0.006) for _ in range(3)] == pytest.approx([last] * 3)
    assert running.step(START_DEG, 0.006) == pytest.approx(last + REACH)


@pytest.mark.parametrize("odd", [math.nan, math.inf, -0.001, 0.007])
def test_nothing_is_written_where_it_is_not_known_what_the_drive_holds(running: Manager, odd: float) -> None:
    running.target(80.0)
    running.step(START_DEG)
    running.call("hold", odd)
    assert [running.call("update") for _ in range(2)] == [-1, -1]
    assert running.held_mm == pytest.approx(1000.0 * odd, nan_ok=True)
    assert running.call("deactivate") == SUCCESS
    assert running.held_mm == pytest.approx(1000.0 * odd, nan_ok=True)
    assert running.call("activate") == ERROR
    running.call("hold", 0.001)
    assert running.call("activate") == SUCCESS
    assert abs(running.step(START_DEG) - 1.0) <= REACH + ROUNDING


def test_a_deactivation_starts_from_what_another_has_written(running: Manager) -> None:
    running.target(80.0)
    running.step(START_DEG)
    running.call("hold", 0.005)
    assert running.call("deactivate") == SUCCESS
    assert running.held_mm == pytest.approx(5.0 - REACH)


def test_an_angle_beyond_the_sensor_is_none(library: ctypes.CDLL) -> None:
    manager = Manager(library, angle_unit="deg", least_angle=20.0, greatest_angle=60.0)
    manager.call("hold", START_MM / 1000.0)
    assert manager.call("configure") == SUCCESS
    manager.call("measure", 60.1)
    assert manager.call("activate") == ERROR
    assert "no usable number" in manager.said
    manager.call("measure", START_DEG)
    assert manager.call("activate") == SUCCESS
    plain = Manager(library)
    assert plain.start(START_DEG, START_MM) == SUCCESS
    for _ in range(30):
        manager.call("measure", 19.9)
        assert manager.call("update") == 0
        assert manager.held_mm == pytest.approx(plain.step(math.nan), abs=1e-9)


def test_a_stop_ramps_to_the_safe_command_and_an_activation_releases_it(running: Manager) -> None:
    assert running.call("stop") == 1
    running.target(80.0)
    assert [running.step(START_DEG) for _ in range(7)] == pytest.approx([1.6, 1.2, 0.8, 0.4, 0.0, 0.0, 0.0])
    assert running.call("deactivate") == SUCCESS
    assert running.held_mm == pytest.approx(0.0)
    running.hold(START_DEG, START_MM)
    assert running.call("activate") == SUCCESS
    running.target(80.0)
    assert running.step(START_DEG) > START_MM


def test_a_deactivation_goes_one_sample_towards_the_safe_command(running: Manager) -> None:
    running.target(80.0)
    command = running.step(START_DEG)
    assert running.call("deactivate") == SUCCESS
    assert running.held_mm == pytest.approx(command - REACH)


@pytest.mark.parametrize("angle", [START_DEG, math.nan])
def test_a_deactivation_at_once_writes_the_safe_command(library: ctypes.CDLL, angle: float) -> None:
    manager = Manager(library, deactivate_at_once=True)
    assert manager.start(START_DEG, START_MM) == SUCCESS
    manager.target(80.0)
    manager.step(START_DEG)
    manager.call("measure", math.radians(angle))
    assert manager.call("deactivate") == SUCCESS
    assert manager.held_mm == 0.0


def test_a_controller_before_it_leads_by_the_reference_interface(library: ctypes.CDLL, running: Manager) -> None:
    topic = Manager(library)
    assert topic.start(START_DEG, START_MM) == SUCCESS
    topic.target(60.0)
    assert running.call("chain", 1) == 1
    running.target(30.0)  # nobody listens to the topic meanwhile
    running.call("refer", math.radians(60.0))
    for _ in range(5):
        assert running.step(START_DEG) == pytest.approx(topic.step(START_DEG), abs=1e-9)
    assert running.call("chain", 0) == 1
    assert running.step(START_DEG) == pytest.approx(topic.step(START_DEG), abs=1e-9)  # the reference stays


def test_a_target_of_before_the_activation_does_not_count(library: ctypes.CDLL) -> None:
    manager = Manager(library)
    assert manager.call("configure") == SUCCESS
    manager.target(80.0)
    manager.hold(START_DEG, START_MM)
    assert manager.call("activate") == SUCCESS
    assert abs(manager.step(START_DEG) - START_MM) < 0.1


def test_a_cleaned_up_controller_listens_to_nobody(running: Manager) -> None:
    assert running.call("deactivate") == SUCCESS
    assert running.call("cleanup") == SUCCESS
    assert running.call("target", 1.0) == 0
    assert running.call("stop") == 0


def test_the_files_around_the_plugin_name_the_same_class_library_and_parameters() -> None:
    source = (PACKAGE / "src" / "controller.cpp").read_text(encoding="utf-8")
    cmake = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    library = ElementTree.parse(PACKAGE / "hystmpc_controller.xml").getroot()
    kind = library.find("class")
    assert kind is not None
    exported = re.findall(r"PLUGINLIB_EXPORT_CLASS\((\S+), (\S+)\)", source)
    assert exported == [(kind.get("type"), kind.get("base_class_type"))]
    assert f"add_library({library.get('path')} SHARED" in cmake
    assert "pluginlib_export_plugin_description_file(controller_interface hystmpc_controller.xml)" in cmake
    config = yaml.safe_load((PACKAGE / "config" / "controllers.yaml").read_text(encoding="utf-8"))
    manager, own = (config[name]["ros__parameters"] for name in ("controller_manager", "tip_controller"))
    assert manager["tip_controller"]["type"] == kind.get("name")
    assert manager["update_rate"] % own["update_rate"] == 0
    declared = set(re.findall(r'auto_declare<[\w:]+>\("(\w+)"', source))
    assert own.keys() - {"update_rate"} <= declared
    readme = (PACKAGE / "README.md").read_text(encoding="utf-8")
    assert [name for name in declared if f"`{name}`" not in readme] == []


@pytest.mark.slow
@pytest.mark.parametrize("compiler", compilers("c++"), ids=lambda command: Path(command[-2 % len(command)]).name)
@pytest.mark.parametrize(
    ("single", "releases"),
    [(False, []), (True, ["-DSTUB_OLD_INTERFACES"])],
    ids=["double, today", "single, before get_optional"],
)
def test_every_compiler_takes_it_without_a_warning(
    compiler: list[str], single: bool, releases: list[str], tmp_path: Path
) -> None:
    """It is not linked: for that the wheel's compiler would build its C++ library, which takes half a minute."""
    arguments = written(tmp_path, single)
    assert tried([*compiler, *arguments, "-O1", *releases, "-c"], tmp_path) == ""


@pytest.mark.slow
def test_it_runs_clean_under_the_sanitizers(tmp_path: Path) -> None:
    arguments, run = written(tmp_path), tmp_path / "run.cpp"
    run.write_text(_RUN, encoding="utf-8")
    checks = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "run.cpp", "-o", "run"]
    compile_c([*arguments, *checks], tmp_path, "c++")
    assert tried([str(tmp_path / "run")], tmp_path) == ""


_RUN = """
struct Manager;
extern "C" {
Manager * manager_new(unsigned int);
void manager_delete(Manager *);
void set_text(Manager *, const char *, const char *);
int configure(Manager *);
int activate(Manager *);
int deactivate(Manager *);
int cleanup(Manager *);
int target(Manager *, double);
void hold(Manager *, double);
void measure(Manager *, double);
long update(Manager *);
}
int main() {
    Manager * m = manager_new(25);
    set_text(m, "joint", "tip");
    for (int life = 0; life < 3; life++) {
        measure(m, 0.8);
        hold(m, 2.0);
        if (configure(m) || activate(m)) return 1;
        for (int k = 0; k < 300; k++) {
            if (k % 40 == 0) target(m, 0.6 + 0.001 * k);
            measure(m, k % 17 ? 0.8 + 0.0005 * k : __builtin_nan(""));
            if (update(m) != 0) return 2;
        }
        if (deactivate(m) || cleanup(m)) return 3;
    }
    manager_delete(m);
    return 0;
}
"""

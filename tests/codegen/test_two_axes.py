"""The exported C of two axes sends what the Python controller of two axes sends, and keeps its laws under any call."""

from __future__ import annotations

import ctypes
import math
import re
import subprocess
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from hystmpc.cli.main import app
from hystmpc.codegen import export_controller
from hystmpc.core.library import FOLDER
from hystmpc.ctrl import TipController
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.trials.errors import ExportError

from ..ctrl.test_two_axes import JOINED, TENDONS, noisy
from ..models.two_axis_examples import COUPLED, DT, RATE, REACH, two_axes
from .compiled import SOURCES, STRICT, Library, compile_c, run_sanitized
from .plane_loops import compare_in_plane, exported
from .test_commands import ANYTHING

PLAIN: Mapping[str, Any] = {"kind": "linearised_mpc", "adaptation": None}
MIX, FRAME = ((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0))
TURNED, LATE = two_axes(MIX, FRAME), two_axes(MIX, FRAME, COUPLED)
NOISY = replace(JOINED, axes=(noisy(JOINED.axes[0]), noisy(JOINED.axes[1])))
CASES: Mapping[str, tuple[TwoAxisModel, Mapping[str, Any]]] = {
    "four-tendons-that-learn": (TENDONS, {"kind": "linearised_mpc"}),
    "late-friction-and-coupling-blocks-and-a-safe-command": (
        LATE,
        {
            **PLAIN,
            "horizon": 40,
            "move_blocking": [1, 1, 2, 4, 8, 8],
            "estimator": {"delay_samples": 2},
            "ladder": {"safe_command": 0.0},
        },
    ),
    "no-sensor": (two_axes(), {"kind": "linearised_mpc", "estimator": {"sensor": "none"}}),
    "frames-that-teach": (
        NOISY,
        {"kind": "linearised_mpc", "estimator": {"sensor": "intermittent", "delay_samples": 1}},
    ),
    "one-sample-behind-a-delay": (TURNED, {**PLAIN, "horizon": 1, "estimator": {"delay_samples": 12}}),
    "random-plans": (JOINED, {"kind": "sampling_mpc", "adaptation": None, "samples": 20, "iterations": 2}),
    "pid-with-frames": (JOINED, {"kind": "pid", "estimator": {"sensor": "intermittent"}}),
    "inverse-and-pid": (TENDONS, {"kind": "inverse_pid"}),
}
START = (0.5, -0.5)
"""Commands at rest [mm]; there the model shows angles near `AT_REST`."""
AT_REST = tuple(float(y) for y in JOINED.run([START] * 2, (0.0, 0.0))[0])
MOVE = RATE * DT * (1 + 1e-12)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Library:
    """Plays that share friction, behind turned tendons."""
    folder = tmp_path_factory.mktemp("made")
    return Library(exported(JOINED, PLAIN, folder), folder, options=["-O0"])


def within(u: Any, last: Any) -> bool:
    """Whether commands are within their limits on value and rate."""
    return all(abs(one) <= REACH and abs(one - before) <= MOVE for one, before in zip(u, last, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_commands_are_those_of_python_for_every_part(case: str, tmp_path: Path) -> None:
    """To the last bit: both are one engine, compiled twice."""
    model, controller = CASES[case]
    # Of 270 samples one stop and one release, at 200 and 230, and two references without a number.
    found = compare_in_plane(model, controller, Library(exported(model, controller, tmp_path), tmp_path), 270)
    np.testing.assert_array_equal(found.c, found.python)
    assert found.same_sources
    assert found.sources["mpc"] + found.sources["feedback"] > 120
    assert {"hold", "stop"} <= found.sources.keys()
    assert np.ptp(found.c, axis=0).min() > 0.5


@pytest.mark.slow
def test_single_precision_stays_close(tmp_path: Path) -> None:
    model, controller = TENDONS, PLAIN
    c = Library(exported(model, controller, tmp_path, single=True), tmp_path, single=True)
    found = compare_in_plane(model, controller, c, 700)
    off = np.abs(found.python - found.c)  # of 3.8 mm
    assert np.median(off) <= 1e-4
    assert np.quantile(off, 0.9) <= 1e-2  # a plan that meets a kink of the model may take its other side


PAIRS = st.tuples(ANYTHING, ANYTHING) | st.tuples(st.floats(-30, 30), st.floats(-30, 30))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(PAIRS, PAIRS, st.booleans()), min_size=1, max_size=30))
def test_any_input_is_answered_within_the_limits(made: Library, inputs: list[tuple[Any, Any, bool]]) -> None:
    assert made.init(AT_REST, START) == 0
    last = list(START)
    for angles, target, late in inputs:
        made.set_target(target)
        if late:
            made.hurry()
        command = made.step(angles)
        assert within(command.u, last)
        assert SOURCES[command.source]
        last = list(command.u)


def test_a_copy_of_the_struct_is_a_snapshot(made: Library) -> None:
    assert made.init(AT_REST, START) == 0
    made.set_target((10.0, 5.0))
    for _ in range(5):
        made.step(AT_REST)
    kept = made.memory.raw
    first = [list(made.step((6.0, 0.0)).u) for _ in range(5)]
    ctypes.memmove(made.memory, kept, len(kept))
    assert [list(made.step((6.0, 0.0)).u) for _ in range(5)] == first


def test_a_target_is_a_constant_reference(made: Library, tmp_path: Path) -> None:
    tip = TipController.from_config({"model": str(JOINED.save(tmp_path / "m.yaml")), "controller": dict(PLAIN)})
    tip.reset(AT_REST, START)
    tip.set_reference([(12.0, 6.0)])
    assert made.init(AT_REST, START) == 0
    made.set_target((12.0, 6.0))
    for share in np.linspace(0.0, 1.0, 30):
        angles = (1 - share) * np.array(AT_REST) + share * np.array([12.0, 6.0])
        np.testing.assert_array_equal(list(made.step(angles).u), tip.step(angles).u)


def test_without_a_target_it_stays_at_the_angles_of_the_start(made: Library) -> None:
    assert made.init(AT_REST, START) == 0
    for _ in range(20):
        assert list(made.step(AT_REST).u) == list(START)


def test_a_stop_is_latched_for_both_axes_until_a_start(made: Library) -> None:
    assert made.init(AT_REST, START) == 0
    made.set_target((12.0, 6.0))
    last = [list(made.step(AT_REST).u) for _ in range(3)][-1]
    made.stop()
    for _ in range(5):
        command = made.step(AT_REST)
        assert (SOURCES[command.source], list(command.u), list(command.status)) == ("stop", last, [1, 1])
    assert made.init(AT_REST, last) == 0
    assert SOURCES[made.step(AT_REST).source] == "mpc"


@pytest.mark.parametrize(
    ("angles", "commands", "answer"),
    [
        ((math.nan, 0.0), START, 1),
        ((0.0, 2e4), START, 1),
        (AT_REST, (0.5, REACH + 1e-6), 2),
        (AT_REST, (math.nan, 0.0), 2),
        ((AT_REST[0], AT_REST[1] + 170.0), START, 3),
    ],
)
def test_a_refused_start_stops_a_controller_that_runs(made: Library, angles: Any, commands: Any, answer: int) -> None:
    """At the commands sent last, also where the first axis alone could start."""
    assert made.init(AT_REST, START) == 0
    made.set_target((12.0, 6.0))
    last = [list(made.step(AT_REST).u) for _ in range(4)][-1]
    assert last != list(START)
    assert made.init(angles, commands) == answer
    stopped = [made.step(AT_REST) for _ in range(3)]
    assert [(SOURCES[command.source], list(command.u)) for command in stopped] == [("stop", last)] * 3


def test_memory_that_nothing_has_started_stands_still(made: Library) -> None:
    """Also where the model of one axis alone can rest at the angles of the start."""
    for x, y in ((170.0, 0.0), (0.0, 170.0)):
        ctypes.memset(made.memory, 0, made.memory_bytes)
        assert made.init((AT_REST[0] + x, AT_REST[1] + y), START) == 3
        assert (made.measure(AT_REST, 0.0), made.look_on(AT_REST, START)) == (0, 1)
        commands = [made.step(AT_REST) for _ in range(3)]
        assert [(SOURCES[one.source], list(one.u)) for one in commands] == [("stop", list(START))] * 3
    for byte in (0x00, 0x55, 0xFF):
        ctypes.memset(made.memory, byte, made.memory_bytes)
        assert made.init((math.nan, 0.0), (1.0, 7.0)) == 1
        made.set_target((10.0, 10.0))
        assert (made.measure((1.0, 1.0), 0.0), made.look_on((1.0, 1.0), (0.0, 0.0))) == (0, 1)
        commands = [made.step((0.0, 0.0)) for _ in range(3)]
        assert [(SOURCES[one.source], list(one.u)) for one in commands] == [("stop", [1.0, REACH])] * 3


def test_who_looked_on_goes_on_from_what_the_other_sent(made: Library) -> None:
    """A command that is no number counts as held; one beyond the limits as the nearest."""
    assert made.init(AT_REST, START) == 0
    made.set_target((12.0, 6.0))
    sent = list(made.step(AT_REST).u)
    for other, held in (((1.0, -1.0), [1.0, -1.0]), ((math.nan, 0.2), [1.0, 0.2]), ((math.inf, -9.0), [1.0, -REACH])):
        assert made.look_on(AT_REST, other) == 0
        sent = held
    made.set_target(JOINED.run([sent] * 2, (0.0, 0.0))[0])
    assert within(made.step(AT_REST).u, sent)


def test_looking_on_is_what_a_step_that_sends_the_same_remembers(made: Library) -> None:
    """Hysteresis, drive and shared friction: after the same commands both foretell the same angles."""
    plant, seen = [], []
    for looks_on in (False, True):
        assert made.init(AT_REST, START) == 0
        made.set_target((12.0, 6.0))
        for k in range(12):
            angles = (AT_REST[0] + 0.3 * k, AT_REST[1] + 0.2 * k)
            if looks_on:
                assert made.look_on(angles, plant[k]) == 0
            else:
                plant.append(list(made.step(angles).u))
        made.hurry()
        made.set_target(AT_REST)
        made.stop()
        seen.append(list(made.step(AT_REST).predicted_deg))
    np.testing.assert_allclose(seen[0], seen[1], rtol=0, atol=1e-9)


def test_a_frame_with_one_angle_changes_nothing(tmp_path: Path) -> None:
    """As in Python, which refuses it: the other angle is not used either."""
    c = Library(exported(two_axes(), {"kind": "pid", "estimator": {"sensor": "intermittent"}}, tmp_path), tmp_path)
    assert c.init((0.0, 0.0), (0.0, 0.0)) == 0
    for _ in range(3):
        c.step((math.nan, math.nan))
    kept = c.memory.raw
    for frame, age in (((3.0, math.nan), 0.0), ((math.nan, 3.0), 1.0), ((3.0, 2e4), 0.0), ((3.0, 3.0), -1.0)):
        assert c.measure(frame, age) == 0
    assert c.memory.raw == kept
    assert c.measure((3.0, 3.0), 0.0) == 1
    assert c.memory.raw != kept


@pytest.mark.slow
def test_any_call_in_any_order_keeps_the_limits_and_a_finite_state(tmp_path: Path) -> None:
    """Under the sanitizers; the program fails where it is asked for half of the rate."""
    run_sanitized(exported(LATE, PLAIN, tmp_path), tmp_path, 500, "fuzzed_axes.c")
    done = subprocess.run([tmp_path / "run", "0.5"], capture_output=True, timeout=60, check=False)
    assert done.returncode == 5


@pytest.mark.parametrize("name", ["axes.c", "cross_friction.c"])
def test_what_an_optimiser_finds_is_no_warning(name: str, tmp_path: Path) -> None:
    compile_c([*STRICT, "-O3", "-Wno-unused-function", "-c", str(FOLDER / name), "-o", "made.o"], tmp_path)


def test_header_and_source_of_two_axes(tmp_path: Path) -> None:
    export = exported(TENDONS, PLAIN, tmp_path)
    for line in ("HYSTMPC_AXES 2", "HYSTMPC_COMMANDS 4", "HYSTMPC_LOWEST {0.2, 0.2, 0.2, 0.2}", "HYSTMPC_REFERENCE 20"):
        assert f"#define {line}\n" in export.header
    assert (export.axes, export.commands, export.reference_samples) == (2, 4, 20)
    plain = re.sub(r"/\*.*?\*/", "", export.source, flags=re.DOTALL)
    assert re.findall(r"\b(?:malloc|calloc|realloc|free|alloca|printf)\(", plain) == []
    assert not re.findall(r"hystmpc_input\(", export.header)
    export.write(tmp_path)
    (tmp_path / "use.cpp").write_text('#include "hystmpc.h"\nstatic const hystmpc_real low[] = HYSTMPC_LOWEST;\n'
                                      "int main() { return low[0] > 1.0; }\n", encoding="utf-8")  # fmt: skip
    compile_c(["-std=c++11", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "use.cpp"], tmp_path, "c++")


REFUSED: Mapping[str, tuple[dict[str, Any], str]] = {
    "osqp": ({**PLAIN, "solver": "osqp"}, "got controller.solver osqp, supported is active_set"),
    "a law in Python": (
        {"kind": "python", "python": "tests.codegen.own_law:OwnSettings"},
        "got the law OwnSettings written in Python",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_c_is_refused_in_a_line(case: str, tmp_path: Path) -> None:
    controller, line = REFUSED[case]
    with pytest.raises(ExportError) as raised:
        exported(JOINED, controller, tmp_path)
    assert str(raised.value).startswith(f"export-c: {line}")
    assert "\n" not in str(raised.value)


def test_the_command_says_that_there_are_two_axes(tmp_path: Path) -> None:
    TENDONS.save(tmp_path / "both.yaml")
    tip, out = tmp_path / "tip.yaml", tmp_path / "c"
    tip.write_text("model: both.yaml\ncontroller: {kind: pid}\n", encoding="utf-8")
    done = CliRunner().invoke(app, ["export-c", str(tip), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "two axes, 4 commands, a step every 0.04 s" in " ".join(done.output.split())
    assert sorted(path.name for path in out.iterdir()) == ["hystmpc.c", "hystmpc.h"]
    assert export_controller({"model": "both.yaml", "controller": {"kind": "pid"}}, folder=tmp_path).axes == 2

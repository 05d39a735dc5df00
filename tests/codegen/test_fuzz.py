"""Whatever is called on the exported C, in any order and with any numbers, its commands keep the laws."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.codegen import ControllerExport, export_controller
from hystmpc.core.structs import layout

from .compiled import EXAMPLES, SOURCES, Library, compile_c, compilers, library, run_sanitized, tried
from .networks import small_network
from .test_commands import ANYTHING, CASES, PLAIN, START, START_DEG, tip, tip_of

pytestmark = pytest.mark.slow  # seconds together

HERE = Path(__file__).parent

LOWER, UPPER, REACH = 0.5, 5.0, 0.16  # [mm]
LIMITED = tip("builtin:pi", **PLAIN, limits={"lower": LOWER, "upper": UPPER, "rate_per_s": 4.0})
ONE_FILTER = {f"{name}_sigma_deg{per}": 0.01 for name, per in (("sensor", ""), ("drift", "_per_sqrt_s"))}
ONE_FILTER["motion_sigma_deg_per_sqrt_unit"] = 0.01
FUZZED: Mapping[str, tuple[dict[str, Any], bool]] = {
    "frames-lag-delay-blocks-and-soft-limits": (
        tip(
            "builtin:pi",
            0.08,
            **PLAIN,
            move_blocking=[1, 1, 2, 4, 8],
            estimator={"sensor": "intermittent", "oldest_frame_s": 0.4, "delay_samples": 2},
            ladder={"safe_command": 0.0},
            weights={"angle_lower_deg": 40, "angle_upper_deg": 70},
        ),
        False,
    ),
    "no-sensor": (CASES["no-sensor"][0], False),
    "single-learns": (  # every part is one text in either precision
        tip(
            "builtin:backlash",
            supervisor={"inverse_pid_above": 0.3, "pid_above": 0.45},
            estimator={"delay_samples": 2},
        ),
        True,
    ),
    "random-plans": (tip_of("builtin:pi", "sampling_mpc", **PLAIN, samples=20), True),
    "single-inverse-and-pid": (tip_of("builtin:auto", "inverse_pid"), True),
    "single-one-filter": (tip("builtin:pi", **PLAIN, estimator=ONE_FILTER), True),
}


def reach_of(export: ControllerExport) -> str:
    """The greatest move of a sample, as a macro for the program."""
    return f"-DREACH={export.problem.fields['reach']!r}"


def fuzz(settings_: Mapping[str, Any], single: bool, folder: Path, steps: int) -> None:
    export = export_controller(settings_, single=single, folder=EXAMPLES)
    run_sanitized(export, folder, steps, "fuzzed.c", [reach_of(export)])


@pytest.mark.slow
@pytest.mark.parametrize("case", FUZZED)
def test_any_call_in_any_order_keeps_the_limits_and_a_finite_state(case: str, tmp_path: Path) -> None:
    fuzz(*FUZZED[case], tmp_path, 2900)  # a sensor walks away from the 2100th to the 2800th


@pytest.mark.slow
def test_any_call_on_a_network_keeps_the_limits_and_a_finite_state(tmp_path: Path) -> None:
    fuzz(tip(small_network("gru", 5, 1, tmp_path), **PLAIN), False, tmp_path, 800)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Library:
    """Plays whose least command is not zero."""
    return library(LIMITED, tmp_path_factory.mktemp("limited"))


CALLS = st.one_of(
    st.tuples(st.just("step"), ANYTHING, st.none()),
    st.tuples(st.just("look_on"), ANYTHING | st.floats(30.0, 70.0), ANYTHING | st.floats(LOWER, UPPER)),
    st.tuples(st.just("init"), ANYTHING | st.just(START_DEG), ANYTHING | st.floats(LOWER, UPPER)),
    st.tuples(st.sampled_from(["stop", "hurry"]), st.none(), st.none()),
    st.tuples(st.just("set_target"), ANYTHING, st.none()),
)


@settings(max_examples=100, deadline=None)
@given(st.lists(CALLS, min_size=1, max_size=40), st.booleans())
def test_the_next_command_starts_at_the_last_one_sent(
    made: Library, calls: list[tuple[str, Any, Any]], starts: bool
) -> None:
    """Whoever sent it: a step, another while the controller looked on, or who says so at an accepted start."""
    ctypes.memset(made.memory, 0, made.memory_bytes)
    if starts:
        assert made.init(START_DEG, START) == 0
    last, stands = START if starts else math.nan, not starts
    for name, one, other in calls:
        answer = getattr(made, name)(*(value for value in (one, other) if value is not None))
        if name == "init" and answer == 0:
            last, stands = other, False
        elif name == "init" and stands:
            last = min(max(other, LOWER), UPPER) if math.isfinite(other) else LOWER
        elif name == "look_on":
            assert (answer == 0) == (not stands)
            last = min(max(other, LOWER), UPPER) if math.isfinite(other) and not stands else last
        elif name == "step":
            last = last if math.isfinite(last) else LOWER
            assert LOWER <= answer.u <= UPPER
            assert abs(answer.u - last) <= (0.0 if stands else REACH + 1e-12)
            assert not stands or (SOURCES[answer.source], answer.status) == ("stop", 1)
            last = answer.u


def test_a_refused_start_stops_a_controller_that_runs(made: Library) -> None:
    for angle, held, answer in (
        (math.nan, START, 1),
        (1e5, START, 1),
        (START_DEG, UPPER + 1.0, 2),
        (START_DEG, math.nan, 2),
        (170.0, START, 3),
    ):
        assert made.init(START_DEG, START) == 0
        made.set_target(60.0)
        last = [made.step(START_DEG).u for _ in range(4)][-1]
        assert last > START
        assert made.init(angle, held) == answer
        stopped = [made.step(START_DEG) for _ in range(3)]
        assert {(SOURCES[command.source], command.u) for command in stopped} == {("stop", last)}


def test_without_a_sensor_it_holds_and_then_stops(made: Library) -> None:
    """25 samples are bridged, and 25 failures in a row latch the stop, as in Python."""
    assert made.init(START_DEG, START) == 0
    made.set_target(75.0)
    sent = [made.step(math.nan) for _ in range(55)]
    assert {SOURCES[command.source] for command in sent[:25]} == {"mpc"}
    assert {(SOURCES[command.source], command.status) for command in sent[25:49]} == {("hold", 3)}
    assert {SOURCES[command.source] for command in sent[49:]} == {"stop"}
    assert {command.u for command in sent[24:]} == {sent[24].u}
    assert SOURCES[made.step(START_DEG).source] == "stop"


@pytest.mark.parametrize(("target", "end"), [(150.0, UPPER), (-150.0, LOWER)])
def test_an_inverse_beyond_the_limits_ends_on_them(made: Library, target: float, end: float) -> None:
    """The model's own range is wider: 0 to 6 mm."""
    assert made.init(START_DEG, START) == 0
    made.set_target(target)
    last = START
    for _ in range(24):
        made.hurry()
        answer = made.step(START_DEG)
        assert SOURCES[answer.source] == "inverse"
        assert LOWER <= answer.u <= UPPER
        assert abs(answer.u - last) <= REACH + 1e-12
        last = answer.u
    assert last == end


def test_a_sensor_that_walks_away_leaves_a_finite_state(tmp_path: Path) -> None:
    """In single precision no filter of the noise foretells an error of thousands of degrees: all weights are zero."""
    walked = library(FUZZED["single-one-filter"][0], tmp_path, single=True)
    assert walked.init(START_DEG, START) == 0
    for k in range(400):
        answer = walked.step(START_DEG + 12.0 * k)
        assert math.isfinite(answer.predicted_deg)
        assert SOURCES[answer.source] == "mpc"


def test_counts_of_samples_do_not_run_over(made: Library) -> None:
    """At 1 kHz an int is full after 24 days without a sensor."""
    assert made.init(START_DEG, START) == 0
    made.stop()
    head = ctypes.sizeof(layout("hystmpc_head"))
    layout("hystmpc_known").from_buffer(made.memory, -(-head // 8) * 8).missing = 999_999_999  # type: ignore[attr-defined]
    assert [made.step(math.nan).missing for _ in range(3)] == [1_000_000_000] * 3


def test_who_looked_on_goes_on_from_what_the_other_sent(made: Library) -> None:
    """The plan of before is not taken up again, though there is no time for another."""
    assert made.init(START_DEG, START) == 0
    made.set_target(75.0)
    assert made.step(START_DEG).u > START
    for _ in range(3):
        assert made.look_on(START_DEG, 1.0) == 0
    made.set_target(START_DEG)
    made.hurry()
    answer = made.step(START_DEG)
    assert SOURCES[answer.source] == "inverse"
    assert abs(answer.u - 1.0) <= REACH + 1e-12


@pytest.mark.parametrize("compiler", compilers(), ids=lambda command: Path(command[-1]).name)
@pytest.mark.parametrize("options", ["-ffast-math", "-Ofast", "-ffinite-math-only"])
def test_options_that_void_the_checks_are_refused(compiler: list[str], options: str, tmp_path: Path) -> None:
    """In the controller, and in whatever includes its header, such as a loop around it."""
    if options == "-Ofast" and "ziglang" in compiler:
        pytest.skip("its -Ofast keeps not-a-number")
    export_controller(LIMITED, folder=EXAMPLES).write(tmp_path)
    (tmp_path / "loop.c").write_text('#include "hystmpc.h"\n', encoding="utf-8")
    for file in ("hystmpc.c", "loop.c"):
        said = tried([*compiler, "-std=c99", options, "-c", file, "-o", "made.o"], tmp_path)
        assert "which voids every check for not-a-number: leave out -ffast-math" in said
    assert tried([*compiler, "-std=c99", "-c", "loop.c", "-o", "made.o"], tmp_path) == ""


def test_the_program_that_calls_at_random_finds_commands_beyond_the_rate(tmp_path: Path) -> None:
    """Asked for half the rate it fails."""
    export = export_controller(LIMITED, folder=EXAMPLES)
    export.write(tmp_path)
    program = (HERE / "fuzzed.c").read_text(encoding="utf-8")
    (tmp_path / "main.c").write_text(program, encoding="utf-8")
    for reach, wanted in ((REACH, 0), (0.5 * REACH, 5)):
        compile_c(["-std=c99", f"-DREACH={reach!r}", f"-I{HERE}", "-o", "run", "main.c", "-lm"], tmp_path)
        assert subprocess.run([tmp_path / "run"], capture_output=True, timeout=60, check=False).returncode == wanted

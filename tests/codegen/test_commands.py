"""The exported C sends what the Python controller sends."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.codegen import export_controller
from hystmpc.ctrl import TipController
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.load import library_file
from hystmpc.models.simulator import load_simulator, save_simulator

from .compiled import EXAMPLES, SOURCES, Library, library
from .loops import START, START_DEG, compare

SAME = 1e-9  # mm; both are one engine, compiled twice


def tip(model: str, lag_s: float = 0.0, **controller: Any) -> dict[str, Any]:
    """Settings of a `TipController`."""
    return {"model": model, "actuator_lag_s": lag_s, "controller": {"kind": "linearised_mpc", **controller}}


def tip_of(model: str, kind: str, **controller: Any) -> dict[str, Any]:
    """Settings of a controller of another kind."""
    return {"model": model, "controller": {"kind": kind, **controller}}


PLAIN: Mapping[str, Any] = {"adaptation": None}
CASES: Mapping[str, tuple[dict[str, Any], float]] = {
    "plays": (tip("builtin:pi", **PLAIN), 0.0),
    "plays-behind-a-lag": (tip("builtin:auto", **PLAIN), 0.08),
    "lag-of-the-settings": (tip("builtin:pi", 0.08, ladder={"safe_command": 0.0}), 0.08),
    "backlash-that-learns": (tip("builtin:backlash"), 0.1),
    "feedback-takes-over": (
        tip("builtin:backlash", supervisor={"inverse_pid_above": 0.3, "pid_above": 0.45}),
        0.1,
    ),
    "soft-limits": (tip("builtin:pi", **PLAIN, weights={"angle_lower_deg": 40, "angle_upper_deg": 70}), 0.0),
    "blocks": (tip("builtin:pi", **PLAIN, horizon=40, move_blocking=[1, 1, 2, 4, 8, 8]), 0.0),
    "transport-delay": (tip("builtin:backlash", estimator={"delay_samples": 2}), 0.0),
    "no-sensor": (tip("builtin:auto", estimator={"sensor": "none"}), 0.08),
    "network-behind-a-lag": (tip("builtin:lstm", 0.08), 0.08),
    "random-plans": (tip_of("builtin:pi", "sampling_mpc", **PLAIN, samples=60, iterations=2), 0.0),
    "cross-entropy": (tip_of("builtin:backlash", "sampling_mpc", method="cem", noise={"kind": "spline"}), 0.0),
    "frames": (tip("builtin:auto", estimator={"sensor": "intermittent", "delay_samples": 1}), 0.08),
    "pid": (tip_of("builtin:pi", "pid"), 0.0),
    "pid-with-frames": (tip_of("builtin:pi", "pid", estimator={"sensor": "intermittent"}), 0.0),
    "inverse": (tip_of("builtin:pi", "inverse"), 0.0),
    "inverse-over-a-preview": (tip_of("builtin:auto", "inverse"), 0.08),
    "inverse-and-pid": (tip_of("builtin:auto", "inverse_pid", estimator={"sensor": "intermittent"}), 0.08),
    "two-lags": (tip("builtin:auto", 0.05), 0.1),
    "one-sample": (tip("builtin:pi", **PLAIN, horizon=1), 0.0),
    "network-with-an-inverse": ({**tip("builtin:lstm", **PLAIN), "inverse": "builtin:backlash"}, 0.0),
    "given-sigmas": (
        tip(
            "builtin:pi",
            estimator={"sensor_sigma_deg": 0.1, "dead_band_gain_deg_per_unit": 0.5},
            limits={"lower": 0.5, "upper": 5.0, "rate_per_s": 4.0},
            iterations=3,
        ),
        0.0,
    ),
}


GRAIN = 1e-7 * 10.0 * 0.04
"""Of a command [mm]: a share of the greatest move of a sample."""


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Library:
    """Plays without learning."""
    return library(CASES["plays"][0], tmp_path_factory.mktemp("plain"), options=["-O1"])


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_commands_are_those_of_python_for_every_part(case: str, tmp_path: Path) -> None:
    settings_, lag_s = CASES[case]
    # Of 760 samples one stop and one release, at 700 and 730, and three references without a number.
    options = ("-O1", "-march=native") if "lstm" in settings_["model"] else None  # of a size that takes its time
    found = compare(settings_, library(settings_, tmp_path, options=options), 760, lag_s)
    off = np.abs(found.python - found.c)
    # Commands are rounded to a grain: at the middle between two grains the last digit of a sum chooses the side.
    assert np.all((off <= SAME) | (np.abs(off - GRAIN) <= SAME))
    assert np.mean(off > SAME) <= 0.01
    assert found.same_sources
    assert found.sources["mpc"] + found.sources["feedback"] > 250
    assert case != "plays" or {"mpc", "hold", "stop"} <= found.sources.keys()


@pytest.mark.slow
def test_commands_are_those_of_python_with_a_quantised_sensor(tmp_path: Path) -> None:
    """A hold is left only beyond a step of the readings."""
    model = load_simulator(library_file("pi"))
    noise = NoiseModel(
        sensor_sigma_deg=0.26,
        drift_sigma_deg_per_sqrt_s=0.3,
        motion_sigma_deg_per_sqrt_unit=1.0,
        sensor_resolution_deg=0.9,
    )
    assert model.identification is not None
    known = replace(model, identification=model.identification.model_copy(update={"noise": noise}))
    save_simulator(known, tmp_path / "coarse.yaml")
    settings_ = tip(str(tmp_path / "coarse.yaml"), **PLAIN)
    found = compare(settings_, library(settings_, tmp_path), 2000, noise_deg=0.26)
    assert found.greatest <= SAME
    assert found.same_sources


@pytest.mark.slow
@pytest.mark.parametrize("case", ["plays-behind-a-lag", "backlash-that-learns"])
def test_single_precision_stays_close(case: str, tmp_path: Path) -> None:
    settings_, lag_s = CASES[case]
    found = compare(settings_, library(settings_, tmp_path, single=True), 1000, lag_s)
    off = np.abs(found.python - found.c)  # of 6 mm
    assert np.median(off) <= 1e-4
    assert np.quantile(off, 0.9) <= 1e-2  # a plan that meets a kink of the model may take its other side


ANYTHING = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(ANYTHING, ANYTHING), min_size=1, max_size=40))
def test_any_input_is_answered_within_the_limits(plain: Library, inputs: list[tuple[float, float]]) -> None:
    assert plain.init(START_DEG, START) == 0
    last = START
    for angle, target in inputs:
        plain.set_target(target)
        command = plain.step(angle)
        assert 0.0 <= command.u <= 6.0
        assert abs(command.u - last) <= 0.4 + 1e-9
        assert SOURCES[command.source]
        last = command.u


def test_a_copy_of_the_struct_is_a_snapshot(plain: Library) -> None:
    assert plain.init(START_DEG, START) == 0
    plain.set_target(60.0)
    for _ in range(5):
        plain.step(START_DEG)
    kept = plain.memory.raw
    first = [plain.step(50.0).u for _ in range(5)]
    ctypes.memmove(plain.memory, kept, len(kept))
    assert [plain.step(50.0).u for _ in range(5)] == first


def test_a_target_is_a_constant_reference(plain: Library) -> None:
    controller = TipController.from_config(CASES["plays"][0])
    controller.reset(START_DEG, START)
    controller.set_reference([62.0])
    assert plain.init(START_DEG, START) == 0
    plain.set_target(62.0)
    for angle in np.linspace(START_DEG, 61.0, 30):
        assert plain.step(angle).u == pytest.approx(controller.step(float(angle)).u, abs=SAME)


def test_a_stop_is_latched_and_ramps_to_the_safe_command(tmp_path: Path) -> None:
    made = library(tip("builtin:backlash", **PLAIN, ladder={"safe_command": 0.0}), tmp_path)
    assert made.init(START_DEG, START) == 0
    made.stop()
    sent = [made.step(START_DEG) for _ in range(8)]
    assert {SOURCES[command.source] for command in sent} == {"stop"}
    assert [command.u for command in sent] == pytest.approx([1.6, 1.2, 0.8, 0.4, 0.0, 0.0, 0.0, 0.0])
    assert made.init(START_DEG, 0.0) == 0
    assert SOURCES[made.step(START_DEG).source] == "mpc"


def test_a_start_that_makes_no_sense_is_refused(plain: Library) -> None:
    assert plain.init(float("nan"), START) == 1
    assert plain.init(START_DEG, 7.0) == 2
    assert plain.init(170.0, START) == 3


def test_the_memory_that_is_said_is_that_of_the_struct(plain: Library) -> None:
    export = export_controller(CASES["plays"][0], folder=EXAMPLES)
    assert plain.memory_bytes == export.memory_bytes
    assert 0 < export.remembered_bytes < export.memory_bytes
    assert export.functions == ("fabs", "sqrt", "rint")
    assert export.inexact == ()

"""What a study says at its end: the best controller, against the best of the other sort, and what does not count."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.loop import LoopLog
from hystmpc.gap.measured_tracking import measured_runs
from hystmpc.sim.closed_loop import ClosedLoopRun
from hystmpc.sim.compare import compare
from hystmpc.sim.results import (
    Result,
    StudyResult,
    approach_sentence,
    best_figures,
    conclusion,
    load_results,
    tracking_metrics,
)
from hystmpc.sim.study import prepare

from .small import MOVE, SCAN, study

DT = 0.04
LIMITS = CommandLimits(0.0, 6.0, 12.0)


def run_with(error: float, first: int = 0) -> ClosedLoopRun:
    """A hundred samples with that error; in an approach it is 50 deg."""
    zeros, reference = np.zeros(100), np.linspace(30.0, 60.0, 100)
    log = LoopLog(
        time_s=DT * np.arange(1, 101), measured_deg=reference, reference_deg=reference, predicted_deg=reference,
        disturbance_deg=zeros, command=zeros, source=("mpc",) * 100, status=("ok",) * 100, stage_s={"plan": zeros},
        interrupted=False,
    )  # fmt: skip
    off = np.where(np.arange(100) < first, 50.0, error)
    return ClosedLoopRun(log, reference + off, 0.0, DT, "mm", first)


def result(errors: dict[str, float], kinds: dict[str, str], first: int = 0) -> StudyResult:
    config = study(controllers={name: {"kind": kinds[name]} for name in errors})
    runs = [(name, run_with(error, first)) for name, error in errors.items()]
    found = [Result("move", name, LIMITS, run, tracking_metrics(run, LIMITS)) for name, run in runs]
    return StudyResult(config, tuple(found), {})


KINDS = {"a": "linearised_mpc", "b": "pid", "c": "inverse"}


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        ({"a": 0.1, "b": 0.4, "c": 0.2}, "a tracks best: 0.1 deg RMS over the motion, 50 % less than the best without"),
        ({"a": 0.4, "b": 0.1, "c": 0.2}, "b tracks best: 0.1 deg RMS over the motion, 75 % less than the best with "),
        ({"b": 0.1, "c": 0.2}, "b tracks best: 0.1 deg RMS over the motion."),
    ],
)
def test_the_best_is_named_and_held_against_the_other_sort(errors: dict[str, float], said: str) -> None:
    found = result(errors, KINDS)
    assert conclusion(found).startswith(said)
    assert ("a" if errors.get("a") == 0.1 else "b", "rmse_deg") in best_figures(found.of_motion("move"))


def test_errors_that_are_printed_alike_are_equally_good() -> None:
    best = best_figures(result({"a": 0.0494, "b": 0.0486, "c": 0.0505}, KINDS).of_motion("move"))
    assert {controller for controller, name in best if name == "rmse_deg"} == {"a", "b"}


def test_one_controller_alone_is_not_the_best() -> None:
    found = result({"a": 0.1}, KINDS)
    assert conclusion(found) == ""
    assert best_figures(found.of_motion("move")) == frozenset()


def test_an_approach_does_not_count_and_is_said() -> None:
    found = result({"a": 0.1, "b": 0.2}, KINDS, first=50)
    assert [run.metrics.rmse_deg for run in found.results] == pytest.approx([0.1, 0.2])
    assert approach_sentence(found).startswith("The first 2.0 s of move lead from the rest")
    assert approach_sentence(result({"a": 0.1}, KINDS)) == ""


def test_a_motion_that_starts_at_the_rest_needs_no_approach_and_one_far_away_does() -> None:
    rest = prepare(study()).plant.true_angle
    near, far = MOVE | {"start_deg": rest}, MOVE | {"start_deg": rest + 17.0, "targets_deg": [rest + 17.0, 60.0]}
    ready = prepare(study(motions={"near": near, "far": far, "scan": SCAN | {"start_deg": rest}}))
    assert ready.approach_s["near"] == ready.approach_s["scan"] == 0.0
    assert float(ready.motions["far"](0.0)) == pytest.approx(rest)
    assert ready.approach_s["far"] / ready.plant.dt == pytest.approx(round(ready.approach_s["far"] / ready.plant.dt))
    assert float(ready.motions["far"](ready.approach_s["far"])) == pytest.approx(rest + 17.0)
    assert set(prepare(study(motions={"far": far}, approach=False)).approach_s.values()) == {0.0}


@pytest.mark.slow
def test_a_first_jump_no_longer_hides_the_tracking(tmp_path) -> None:
    """The motion of a device, 17 deg away from its rest: without an approach the jump is nearly all of the error."""
    far = MOVE | {"start_deg": 45.0, "targets_deg": [55.0, 48.0]}
    mpc = {"mpc": {"kind": "linearised_mpc"}}
    led = compare(study(motions={"far": far}, controllers=mpc), tmp_path / "led").results[0]
    assert led.run.first > 0
    jumped = compare(study(motions={"far": far}, controllers=mpc, approach=False)).results[0]
    assert led.metrics.rmse_deg < 0.3 * jumped.metrics.rmse_deg
    (back,) = load_results(tmp_path / "led").results
    assert back.run.first == led.run.first
    (measured,) = measured_runs(tmp_path / "led")
    assert (measured.approached_first, measured.rmse_deg) == (True, pytest.approx(led.metrics.rmse_deg))
    np.testing.assert_allclose(measured.reference_deg, measured.reference(measured.t), atol=1e-9)
    assert math.isclose(back.metrics.rmse_deg, led.metrics.rmse_deg, rel_tol=1e-9)


def test_a_target_that_the_model_cannot_reach_is_said() -> None:
    far = MOVE | {"targets_deg": [40.0, 150.0]}
    (warning,) = prepare(study(motions={"far": far, "near": MOVE})).warnings()
    assert warning.startswith("far asks for 2")
    assert "to 150 deg, the model reaches 2" in warning

"""Laws of the free run of two axes: exact on a device that is the model, tip's error of both, state found in motion."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.evaluate import error_table, evaluate, evaluation_json
from hystmpc.models.simulator import ChainModel
from hystmpc.models.two_axes.evaluate import evaluate_two_axes
from hystmpc.trials.errors import ModelError
from hystmpc.trials.trial import Trial, Units

from .two_axis_examples import DT, RATE, SHARED, two_axes, wandering

JOINED = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)), SHARED)


def of_device(seed: int, noise: float = 0.0) -> Trial:
    """A trial of the device that is the model, which begins with a rest."""
    commands = np.vstack([np.zeros((40, 2)), wandering(seed)])
    angles = JOINED.run(commands, np.zeros(2)) + noise * np.random.default_rng(seed).standard_normal(commands.shape)
    return Trial(DT * np.arange(len(commands)), commands, angles)


@settings(max_examples=10)
@given(st.integers(0, 1000))
def test_the_free_run_of_the_device_itself_has_no_error(seed: int) -> None:
    run = evaluate_two_axes(JOINED, of_device(seed))
    assert run.errors.rmse_deg < 1e-9
    assert run.start == 0
    assert run.outside == 0


@settings(max_examples=10)
@given(st.integers(0, 1000))
def test_errors_of_the_tip_are_lengths_of_those_of_both_axes(seed: int) -> None:
    run = evaluate_two_axes(two_axes(), of_device(seed, 0.3))
    for name in ("rmse_deg", "bias_deg", "offset_free_rmse_deg"):
        tip, x, y = (getattr(errors, name) for errors in (run.errors, *run.axes))
        assert tip == pytest.approx(math.hypot(x, y))
    assert run.errors.max_abs_error_deg <= math.hypot(*(errors.max_abs_error_deg for errors in run.axes)) + 1e-12
    left = (run.theta - run.trial.angles)[run.start :]
    assert run.errors.rmse_deg == pytest.approx(math.sqrt(np.mean(np.sum(left**2, axis=1))))


def test_without_a_joint_the_axes_have_the_errors_of_one_axis_alone() -> None:
    model, trial = two_axes(), of_device(3, 0.2)
    run = evaluate_two_axes(model, trial)
    for i, axis in enumerate(model.axes):
        alone = evaluate(
            ChainModel(axis), replace(trial, command=trial.commands[:, i].copy(), angle=trial.angles[:, i].copy())
        )
        assert run.axes[i].rmse_deg == pytest.approx(alone.errors.rmse_deg)
        assert run.axes[i].nrmse == pytest.approx(alone.errors.nrmse)


def test_a_trial_that_begins_in_motion_is_scored_after_its_state_is_found() -> None:
    whole = of_device(5)
    moving = np.flatnonzero(np.all(np.abs(np.diff(whole.commands, axis=0)) > 0.09, axis=1))
    trial = whole.select(next(int(a) for a, b in pairwise(moving) if b == a + 1 and a > 250) + 1)
    run = evaluate_two_axes(JOINED, trial)
    assert run.start > 0
    assert "begins in motion" in run.start_line
    assert run.errors.rmse_deg < 0.5


def test_an_axis_that_stays_is_at_rest_at_its_first_angle() -> None:
    """Its angle moves with the other axis, by the sensor's frame: that is no motion of its own."""
    commands = wandering(2)
    commands[:, 1] = 0.4
    model = two_axes(frame=((1.0, 0.1), (0.2, 1.0)))
    trial = Trial(DT * np.arange(len(commands)), commands, model.run(commands, np.zeros(2)))
    assert evaluate_two_axes(model, trial).errors.rmse_deg < 0.1


def test_json_and_table_have_the_errors_of_tip_and_axes() -> None:
    runs = [evaluate_two_axes(JOINED, of_device(seed, 0.1)) for seed in (1, 2)]
    data = evaluation_json(runs)
    assert data["format"] == "hystmpc-two-axis-evaluation/1"
    for row in (*data["trials"], data["mean"]):
        assert set(row["tip"]) == set(row["x"]) == set(row["y"])
    assert data["mean"]["x"]["rmse_deg"] == pytest.approx(np.mean([run.axes[0].rmse_deg for run in runs]))
    columns, rows = error_table(runs)
    assert {len(row) for row in rows} == {len(columns)}
    assert [row[0] for row in rows][-1] == "mean"


@pytest.mark.parametrize(
    ("trial", "words"),
    [
        (of_device(1).with_signals(lambda values: values, units=Units("bar", "deg")), "expected mm"),
        (of_device(1).with_signals(lambda values: values[::2]), "resample"),
    ],
)
def test_other_units_and_rates_are_one_line(trial: Trial, words: str) -> None:
    with pytest.raises(ModelError, match=words) as refused:
        evaluate_two_axes(JOINED, trial)
    assert len(str(refused.value)) <= 300


def test_a_model_of_tendons_is_refused_in_a_line() -> None:
    four = JOINED.with_tendons([0, 90, 180, 270], pretension=1.0, limits=[(0.2, 4.0)] * 4, rates_per_s=[RATE] * 4)
    with pytest.raises(ModelError, match="a model of 4"):
        evaluate_two_axes(four, of_device(1))

"""Lack of fit: structure that a selected effect leaves in the error and that contradicts it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.models.identify.selection import Selection
from hystmpc.trials.types import Mat, Vec

from .configuration import configuration_of
from .verdict import VerdictSettings

_KNOTS = 10  # of a curve, in each direction
_SLOW_S = 3.0


def structure_left(
    selection: Selection, runs: Sequence[Run], everything: Sequence[Run], floor_mse: float, settings: VerdictSettings
) -> bool:
    """Whether the only effect selected leaves structure that it would not leave if it were the cause.

    A curved gain leaves no other curve of the angle (`remaining_curvature`). Shifts between trials leave no slow change
    within them (`slow_mse`). Widths of single trials belong to groups of trials: else they follow the speed of the
    motions, as with a friction that depends on it.

    Args:
        selection: of the causes.
        runs: development runs.
        everything: all runs; groups of few trials show in all of them alone.
        floor_mse: below which an error carries no evidence [deg^2].
        settings: thresholds.
    """
    chosen, retuned = selection.chosen.hypothesis, selection.baseline.hypothesis
    if chosen.problem.terms.shift and chosen.problem.terms.width >= 0 and configuration_of(chosen, everything) is None:
        return True
    if chosen.effects == {"nonlinear_gain"}:
        before = retuned.mse - floor_mse
        if before <= 0 or chosen.mse < settings.still_open * floor_mse:
            return False
        left = remaining_curvature(chosen, runs, floor_mse)
        return left > settings.curve_left and left * (chosen.mse - floor_mse) > settings.curve_size * before
    if chosen.effects == {"trial_shift"}:
        # The model-form error is slow as well and is part of the floor.
        return slow_mse(chosen, runs) - floor_mse > settings.wander * (retuned.mse - chosen.mse)
    return False


def remaining_curvature(hypothesis: Hypothesis, runs: Sequence[Run], floor_mse: float) -> float:
    """Share of the remaining structural error that two free curves of the simulated angle explain, 0 to 1.

    One curve applies while the simulated angle rises and another while it falls, each piecewise linear between ten
    knots at quantiles of the angle, fitted by least squares to the errors of all runs together. A quadratic and a cubic
    term that imitate a corner, a toe or another branch leave such curves; those of a smooth gain do not.

    Args:
        hypothesis: fitted to the runs.
        runs: development runs.
        floor_mse: below which an error carries no evidence [deg^2].
    """
    angles, errors = [], []
    for run in runs:
        theta = hypothesis.problem.angles(hypothesis.q, run)
        rises = np.gradient(theta) >= 0
        angles.append(np.stack([theta, rises], axis=1)[run.counts])
        errors.append((run.angle - theta)[run.counts])
    theta, rises = np.concatenate(angles).T
    error = np.concatenate(errors)
    structural = float(np.mean(error**2)) - floor_mse
    if structural <= 0:
        return 0.0
    columns = _hat_functions(theta)
    columns = np.concatenate([columns * rises[:, None], columns * (1 - rises)[:, None]], axis=1)
    weights = np.linalg.lstsq(columns, error, rcond=None)[0]
    explained = float(np.mean(error**2) - np.mean((error - columns @ weights) ** 2))
    return float(np.clip(explained / structural, 0.0, 1.0))


def slow_mse(hypothesis: Hypothesis, runs: Sequence[Run]) -> float:
    """Mean square of the remaining error's means over three seconds [deg^2], slow change within trials."""
    total, count = 0.0, 0
    for run in runs:
        error, blocks = hypothesis.problem.error(hypothesis.q, run)[0], run.blocks(_SLOW_S)
        blocks = blocks - blocks.min()
        samples = np.bincount(blocks)
        means = np.bincount(blocks, error)[samples > 0] / samples[samples > 0]
        total, count = total + float(np.sum(means**2)), count + means.size
    return total / count


def _hat_functions(x: Vec) -> Mat:
    """Piecewise linear functions (T, K), one at each knot."""
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _KNOTS)))
    return np.stack([np.interp(x, knots, row) for row in np.eye(knots.size)], axis=1)

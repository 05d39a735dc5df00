"""Lack of fit: whether what a curved gain leaves still depends on angle and direction: then it was another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.trials.types import Vec

_KNOTS = 10  # of a curve, in each direction


def remaining_curvature(hypothesis: Hypothesis, runs: Sequence[Run], floor_mse: float) -> float:
    """Share of the structural error left that two free curves of the simulated angle explain, 0 to 1.

    One curve while the simulated angle rises and another while it falls, each piecewise linear between ten knots at
    quantiles of the angle, fitted by least squares to the error of all runs together. A quadratic and a cubic term that
    stand for a corner, a toe or another branch leave such a curve; those of a smooth gain leave none.

    Args:
        hypothesis: fitted to the runs.
        runs: development runs.
        floor_mse: what is no news [deg^2].
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
    columns = _hats(theta)
    columns = np.concatenate([columns * rises[:, None], columns * (1 - rises)[:, None]], axis=1)
    weights = np.linalg.lstsq(columns, error, rcond=None)[0]
    explained = float(np.mean(error**2) - np.mean((error - columns @ weights) ** 2))
    return float(np.clip(explained / structural, 0.0, 1.0))


def _hats(x: Vec) -> Vec:
    """Piecewise linear functions (T, K), one at each knot."""
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _KNOTS)))
    return np.stack([np.interp(x, knots, row) for row in np.eye(knots.size)], axis=1)

"""Joint fits of baseline and effects to runs: bounded least squares on free-run errors with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.optimize import least_squares

from hystmpc.trials.types import Vec

from .problem import Problem
from .recording import Run

_EDGE = 1e-9
_JITTER = 1e-13
_DIVERGED = 1e9
_COMMON = 1.0  # of the samples, that the mean of the trials' own terms counts as
_HELD = 1e-10  # of the greatest curvature: what no run determines stays where it began


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit ended.

    Attributes:
        q: unknowns.
        mse: mean square of the errors that count [deg^2].
        evaluations: free runs over all trials.
    """

    q: Vec
    mse: float
    evaluations: int


def fit(problem: Problem, runs: Sequence[Run], start: Vec, evaluations: int = 25, tolerance: float = 1e-4) -> Fit:
    """Fit from one start.

    Args:
        problem: what is fitted.
        runs: trials; their counted samples weigh the same.
        start: unknowns (Q,); brought within the bounds.
        evaluations: greatest number of free runs over all trials.
        tolerance: relative change of the error at which it is done.
    """
    margin = _EDGE * (problem.upper - problem.lower)
    inside = np.clip(start, problem.lower + margin, problem.upper - margin)
    search = _Search(problem, runs, inside)
    result = least_squares(
        search.residuals,
        inside,
        cast(Any, search.jacobian),
        bounds=(problem.lower, problem.upper),
        x_scale=1.0,
        ftol=tolerance,
        xtol=1e-6,
        gtol=1e-12,
        max_nfev=evaluations,
    )
    return Fit(result.x, search.mse(result.x), search.evaluations)


class _Search:
    """Errors and derivatives of all runs, condensed: the triangle R of a QR factorisation of (J, r).

    Least squares needs no more than the norm of r, J^T r and the singular values of J, and R has them all; with ten
    thousand samples the solver's own decompositions would cost more than the free runs.

    Where each trial has an offset and a gain of its own, nothing determines the common ones. They are those against
    which the trials' own have no mean: the mean of each counts as an error of every sample.
    """

    def __init__(self, problem: Problem, runs: Sequence[Run], start: Vec) -> None:
        self._problem, self._runs, self._start = problem, runs, start
        self._samples = sum(int(run.counts.sum()) for run in runs)
        self._at: Vec | None = None
        self._triangle: Vec = np.empty((0, 0))
        self._energy = 0.0
        self.evaluations = 0

    def residuals(self, q: Vec) -> Vec:
        return self._condensed(q)[:, -1]

    def jacobian(self, q: Vec) -> Vec:
        return self._condensed(q)[:, :-1]

    def mse(self, q: Vec) -> float:
        """Mean square of the errors that count [deg^2]."""
        self._condensed(q)
        return self._energy / self._samples

    def _condensed(self, q: Vec) -> Vec:
        if self._at is None or not np.array_equal(q, self._at):
            square, common = np.zeros((q.size + 1, q.size + 1)), []
            for run in self._runs:
                (error, by_q), (own, own_by_q) = self._problem.error_and_common(q, run)
                both = np.column_stack([by_q, error])
                square += both.T @ both
                common.append(np.column_stack([own_by_q, own]))
            mean = np.mean(common, axis=0)
            self._energy = float(square[-1, -1])
            self._triangle = _triangle(square + self._pull(square, q) + _COMMON * self._samples * mean.T @ mean)
            self._at = q.copy()
            self.evaluations += 1
        return self._triangle

    def _pull(self, square: Vec, q: Vec) -> Vec:
        """What the distance from the start adds to the products of derivatives and errors."""
        away = np.column_stack([np.eye(q.size), q - self._start])
        return np.asarray(_HELD * np.max(np.diag(square)[:-1], initial=0.0) * away.T @ away)


def _triangle(square: Vec) -> Vec:
    """R with R^T R = square; a run that is not finite counts as a very bad one without a direction."""
    size = square.shape[0]
    if not np.all(np.isfinite(square)):
        return np.vstack([np.zeros((size - 1, size)), np.append(np.zeros(size - 1), _DIVERGED)[None]])
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    correlation = square / np.outer(scale, scale) + _JITTER * np.eye(size)
    return np.asarray(np.linalg.cholesky(correlation).T * scale, dtype=np.float64)

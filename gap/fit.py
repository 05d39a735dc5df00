"""Joint fits of baseline and effects to runs: bounded least squares on free-run errors with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .problem import Problem
from .recording import Run

Vec = NDArray[np.float64]
_EDGE = 1e-9


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
    search = _Search(problem, runs)
    margin = _EDGE * (problem.upper - problem.lower)
    inside = np.clip(start, problem.lower + margin, problem.upper - margin)
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
    return Fit(result.x, float(np.mean(search.residuals(result.x) ** 2)), search.evaluations)


class _Search:
    """Residuals and Jacobian apart, computed once."""

    def __init__(self, problem: Problem, runs: Sequence[Run]) -> None:
        self._problem, self._runs = problem, runs
        self._at: Vec | None = None
        self._residuals: Vec = np.empty(0)
        self._jacobian: Vec = np.empty((0, 0))
        self.evaluations = 0

    def residuals(self, q: Vec) -> Vec:
        if self._at is None or not np.array_equal(q, self._at):
            pairs = [self._problem.error(q, run) for run in self._runs]
            self._residuals = np.nan_to_num(np.concatenate([r for r, _ in pairs]), nan=1e6, posinf=1e6, neginf=-1e6)
            self._jacobian = np.nan_to_num(np.vstack([j for _, j in pairs]))
            self._at = q.copy()
            self.evaluations += 1
        return self._residuals

    def jacobian(self, q: Vec) -> Vec:
        self.residuals(q)
        return self._jacobian

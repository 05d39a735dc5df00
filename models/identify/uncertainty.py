"""How well logs determine the numbers of a simulator: a covariance that neighbouring residuals do not fool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hystmpc.trials.types import Vec

from .problem import Problem
from .runs import Run

_BLOCKS_S = (3.0, 6.0, 12.0)
_AT_BOUND = 1e-3  # of the unknowns' typical changes
_TOLERANCE = 1e-8  # of the greatest eigenvalue: what is less has no information
_FLAT_LOG, _FLAT_RANGE = float(np.log(3.0)), 0.25  # half width of the interval: a factor; of the range between bounds


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How well the development errors determine the unknowns.

    Attributes:
        covariance: of the unknowns q (Q, Q); zero for those at a bound.
        quantile: of Student's t, 95 %, by which a standard error becomes half an interval of 90 %.
        flat: unknowns that the errors do not determine (Q,).
        at_bound: unknowns that ended at an edge of their range (Q,).
    """

    covariance: Vec
    quantile: float
    flat: NDArray[np.bool_]
    at_bound: NDArray[np.bool_]

    def half_width(self, slope: Vec) -> float:
        """Half the interval of 90 % of a quantity with derivative `slope` (Q,) by the unknowns."""
        return self.quantile * float(np.sqrt(max(float(slope @ self.covariance @ slope), 0.0)))


def uncertainty(problem: Problem, q: Vec, runs: Sequence[Run]) -> Uncertainty:
    """Gauss-Newton covariance with the spread of block sums (sandwich).

    C = H^+ (sum_b g_b g_b^T) H^+ B / (B - Q),  H = J^T J,  g_b = J_b^T e_b

    over blocks b of time, whose errors may be correlated within; of blocks of 3, 6 and 12 s those with the largest
    variance count. Unknowns at a bound are held there.

    Source: Liang, Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73 (1986), eq. (8).
    """
    pairs = [problem.error(q, run) for run in runs]
    at_bound = np.minimum(np.abs(q - problem.lower), np.abs(q - problem.upper)) < _AT_BOUND
    free = np.flatnonzero(~at_bound)
    hessian = sum((j[:, free].T @ j[:, free] for _, j in pairs), np.zeros((free.size, free.size)))
    inverse, lost = _inverse(hessian)
    best, quantile = np.zeros_like(hessian), float(student.ppf(0.95, 1))
    for seconds in _BLOCKS_S:
        scores = np.array(
            [g for (e, j), run in zip(pairs, runs, strict=True) for g in _scores(e, j[:, free], run, seconds)]
        )
        spare = len(scores) - free.size
        if spare < 1 or (spare < 2 * free.size and best.any()):
            break
        found = inverse @ (scores.T @ scores) @ inverse * len(scores) / spare
        if np.trace(found) > np.trace(best):
            best, quantile = found, float(student.ppf(0.95, spare))
    covariance = np.zeros((q.size, q.size))
    covariance[free[:, None], free[None, :]] = best
    flat = _flat(problem, quantile * np.sqrt(np.diag(covariance)))
    flat[free[lost]] = True
    return Uncertainty(covariance, quantile, flat & ~at_bound, at_bound)


def _inverse(hessian: Vec) -> tuple[Vec, NDArray[np.bool_]]:
    """Pseudo-inverse (Q, Q), and which unknowns have a part in what it leaves out (Q,)."""
    size = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    weights, turn = np.linalg.eigh(hessian / np.outer(size, size))
    seen = weights > _TOLERANCE * max(float(weights.max(initial=0.0)), 1e-300)
    inverse = (turn[:, seen] / weights[seen]) @ turn[:, seen].T / np.outer(size, size)
    lost = (turn[:, ~seen] ** 2).sum(axis=1) > 0.5
    return inverse, lost | (size <= 1e-140)


def _scores(error: Vec, by_q: Vec, run: Run, seconds: float) -> list[Vec]:
    """Derivative of half the squared error of each block (Q,)."""
    blocks = run.blocks(seconds)
    return [by_q[blocks == b].T @ error[blocks == b] for b in np.unique(blocks)]


def _flat(problem: Problem, half: Vec) -> NDArray[np.bool_]:
    """Unknowns whose interval is no narrower than a factor of three either way, or half of their range."""
    logarithmic = np.zeros(problem.size, dtype=np.bool_)
    scales = [freedom.scale for c in problem.effects for freedom in c.free]
    if scales:
        logarithmic[-len(scales) :] = np.array(scales) == 0
    return np.where(logarithmic, half > _FLAT_LOG, half > _FLAT_RANGE * (problem.upper - problem.lower))

"""Bounded least squares: the solver of all fits, and the fit of a hypothesis to runs."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from hystmpc.trials.types import Mat, Vec

from .problem import Problem
from .runs import AS_IT_IS, Run, RunsTogether

P = ParamSpec("P")
R = TypeVar("R")


_EDGE = 1e-9
_JITTER = 1e-13
_DIVERGED = 1e9
_COMMON = 1.0  # of the samples, that the mean of the trials' own terms counts as
_HELD = 1e-10  # of the greatest curvature: what no run determines stays where it began


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator that runs a function on one BLAS thread.

    The products of a fit are tall and narrow: with two threads a diagnosis took up to seven times the processor time.
    """

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


def minimise(evaluate: Callable[[Vec], tuple[Vec, Mat]], start: Vec, bounds: tuple[Vec, Vec], **options: Any) -> Vec:
    """Least squares within bounds; residuals and Jacobian of a point are computed together, once."""
    known: tuple[Vec, tuple[Vec, Mat]] | None = None

    def both(q: Vec) -> tuple[Vec, Mat]:
        nonlocal known
        if known is None or not np.array_equal(q, known[0]):
            known = q.copy(), evaluate(q)
        return known[1]

    jacobian = cast(Any, lambda q: both(q)[1])  # SciPy is untyped: pyright takes `jac` for a string, as its default is
    solution = least_squares(lambda q: both(q)[0], start, jac=jacobian, bounds=bounds, **options)
    return np.asarray(solution.x, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """Result of a fit of a hypothesis.

    Attributes:
        q: unknowns.
        mse: mean square of the errors that count [deg^2].
    """

    q: Vec
    mse: float


def fit_problem(
    problem: Problem,
    runs: Sequence[Run],
    start: Vec,
    evaluations: int = 25,
    tolerance: float = 1e-4,
    white: Vec = AS_IT_IS,
) -> LeastSquaresFit:
    """Fit a hypothesis to runs from one start.

    Args:
        problem: what is fitted.
        runs: trials; their counted samples weigh the same.
        start: unknowns (Q,); brought within the bounds.
        evaluations: greatest number of free runs over all trials.
        tolerance: relative change of the error at which it is done.
        white: filter of the errors whose squares are summed (`whitening`).
    """
    margin = _EDGE * (problem.upper - problem.lower)
    inside = np.clip(start, problem.lower + margin, problem.upper - margin)
    search = _CondensedSearch(problem, runs, inside, white)
    q = minimise(
        search.evaluate,
        inside,
        (problem.lower, problem.upper),
        x_scale=1.0,
        ftol=tolerance,
        xtol=1e-6,
        gtol=1e-12,
        max_nfev=evaluations,
    )
    return LeastSquaresFit(q, search.mse(q))


class _CondensedSearch:
    """Errors and derivatives of all runs as the triangle R of a QR factorisation of (J, r)."""

    def __init__(self, problem: Problem, runs: Sequence[Run], start: Vec, white: Vec) -> None:
        self._problem, self._start, self._white, self._groups = problem, start, white, RunsTogether.groups(runs)
        self._samples = sum(int(run.counts.sum()) for run in runs)
        self._at: Vec | None = None
        self._energy = 0.0

    def mse(self, q: Vec) -> float:
        """Mean square of the errors that count [deg^2]."""
        if self._at is None or not np.array_equal(q, self._at):
            self.evaluate(q)
        return self._energy / self._samples

    def evaluate(self, q: Vec) -> tuple[Vec, Mat]:
        products = [self._problem.products(q, group, self._white) for group in self._groups]
        square, common = (
            np.sum([normal for normal, _ in products], axis=0),
            [row for _, rows in products for row in rows],
        )
        self._at, self._energy = q.copy(), float(square[-1, -1])
        square = square + self._pull(square, q)
        if common:
            mean = np.mean(common, axis=0)
            square += _COMMON * self._samples * mean.T @ mean
        triangle = _triangle(square)
        return triangle[:, -1], triangle[:, :-1]

    def _pull(self, square: Vec, q: Vec) -> Vec:
        """Products of derivatives and errors of the distance from the start and of roughness."""
        away = np.column_stack([np.eye(q.size), q - self._start])
        rough = np.column_stack([self._problem.roughness, self._problem.roughness @ q])
        return np.asarray(_HELD * np.max(np.diag(square)[:-1], initial=0.0) * away.T @ away + rough.T @ rough)


def _triangle(square: Vec) -> Vec:
    """R with R^T R = square; a run that is not finite counts as very bad, without a direction."""
    size = square.shape[0]
    if not np.all(np.isfinite(square)):
        return np.vstack([np.zeros((size - 1, size)), np.append(np.zeros(size - 1), _DIVERGED)[None]])
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    correlation = square / np.outer(scale, scale) + _JITTER * np.eye(size)
    return np.asarray(np.linalg.cholesky(correlation).T * scale, dtype=np.float64)

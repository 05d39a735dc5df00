"""Bounded least squares, the solver of all fits."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from hystmpc.trials.types import Mat, Vec

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_JITTER = 1e-13
_DIVERGED = 1e9  # in working units
_MANY = 10_000  # samples
_THREADS = 2


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator that runs a function on one BLAS thread, since two made a diagnosis up to seven times as slow."""

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


def side_by_side(function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Results of independent fits, in order, two at a time: the engine's calls let other threads run."""
    pool = ThreadPoolExecutor(_THREADS)
    try:
        yield from pool.map(function, items)
    finally:
        pool.shutdown(cancel_futures=True)


def minimise(evaluate: Callable[[Vec], tuple[Vec, Mat]], start: Vec, bounds: tuple[Vec, Vec], **options: Any) -> Vec:
    """Least squares within bounds; residuals and Jacobian of a point are computed together."""
    known: tuple[Vec, tuple[Vec, Mat]] | None = None

    def both(q: Vec) -> tuple[Vec, Mat]:
        nonlocal known
        if known is None or not np.array_equal(q, known[0]):
            known = q.copy(), evaluate(q)
        return known[1]

    jacobian = cast(Any, lambda q: both(q)[1])  # SciPy is untyped: pyright takes `jac` for a string, as its default is
    solution = least_squares(lambda q: both(q)[0], start, jac=jacobian, bounds=bounds, **options)
    return np.asarray(solution.x, dtype=np.float64)


def triangle_of(square: Vec) -> Vec:
    """R with R^T R = square; a run that is not finite counts as a very large error without a direction."""
    size = square.shape[0]
    if not np.all(np.isfinite(square)):
        return np.vstack([np.zeros((size - 1, size)), np.append(np.zeros(size - 1), _DIVERGED)[None]])
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    correlation = square / np.outer(scale, scale) + _JITTER * np.eye(size)
    return np.asarray(np.linalg.cholesky(correlation).T * scale, dtype=np.float64)


def condensed(residuals: Vec, jacobian: Mat) -> tuple[Vec, Mat]:
    """Residuals and Jacobian; for many samples the equivalent triangle of a QR factorisation."""
    if residuals.size < _MANY or not np.all(np.abs(jacobian) < _DIVERGED):
        return residuals, jacobian
    triangle = np.asarray(np.linalg.qr(np.column_stack([jacobian, residuals]), mode="r"))
    return triangle[:, -1], triangle[:, :-1]

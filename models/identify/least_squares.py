"""Bounded least squares: SciPy's for smooth errors, and steps in boxes for many bounds, linear unknowns and kinks."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from hystmpc.core.library import engine
from hystmpc.trials.types import Mat, Vec

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_DIVERGED = 1e9  # in working units
_MANY = 10_000  # samples
_JITTER = 1e-13  # share of a correlation of unknowns: makes every program convex
_LEAST_NORM = 1e-150
_MARGIN = 1e-9  # share of the distance of both bounds: derivatives at a bound are one-sided
_FIRST_REACH = 0.19  # not round: at whole samples of a delay the error has a kink
_POOR, _GOOD, _SMALLER, _LARGER = 0.25, 0.75, 0.25, 2.0
_AT_REACH = 0.95
_LIMITED = 0.1  # of the tolerance, at which a search ends whose step the box has limited: it would go farther
_LEAST_STEP = 1e-6  # in units: a search ends where a step below it is refused
_REFUSED = 2  # steps in a row, after which an unknown is not taken for linear
_HALVINGS = 12  # of the weights of two linearisations
_CHANGES = 10  # of the active set, for each unknown
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


def condensed(residuals: Vec, jacobian: Mat) -> tuple[Vec, Mat]:
    """Residuals and Jacobian; for many samples the equivalent triangle of a QR factorisation."""
    if residuals.size < _MANY or not np.all(np.abs(jacobian) < _DIVERGED):
        return residuals, jacobian
    triangle = np.asarray(np.linalg.qr(np.column_stack([jacobian, residuals]), mode="r"))
    return triangle[:, -1], triangle[:, :-1]


def minimise_in_boxes(
    products: Callable[[Vec], Mat],
    start: Vec,
    bounds: tuple[Vec, Vec],
    units: Vec,
    evaluations: int,
    tolerance: float,
) -> Vec:
    """Least squares within bounds by Gauss-Newton steps in a box that grows and shrinks.

        d = argmin |J d + r|^2   s.t.   lower <= q + d <= upper,   |d_i| <= reach units_i

    The engine's active-set method finds the exact optimum of every step: one step solves a linear problem, whatever
    bounds it touches, and rounding errors stay rounding errors. The box bounds linear unknowns too once two steps in a
    row were refused: r may be linear in them only as long as the state before the first sample stays within its bounds.
    At a kink of r the linearisations on its two sides each lead across it. After a poor step the greater of both errors
    is lowered, as a bundle method does, so that the search goes on along the kink.

    Args:
        products: of the columns of (J, r) at unknowns q (Q + 1, Q + 1).
        start: unknowns (Q,), brought inside the bounds.
        bounds: lower and upper (Q,).
        units: usual steps of the unknowns (Q,); infinite for those in which r is linear while the others stay.
        evaluations: greatest number of calls of `products`.
        tolerance: relative fall of the squared error at which the search ends; a tenth where the box limits the step.

    Source: Conn, Gould, Toint, Trust-Region Methods (2000), algorithm 6.1.1 with the infinity norm, section 7.8;
    of two linearisations: Lemarechal, in Nondifferentiable Optimization, Math. Programming Study 3 (1975).
    """
    wide = bounds[1] - bounds[0]
    margin = np.where(np.isfinite(wide), _MARGIN * wide, 0.0)
    lower, upper = bounds[0] + margin, bounds[1] - margin
    q, reach, refused = np.clip(start, lower, upper), _FIRST_REACH, 0
    square, beyond = products(q), None
    for _ in range(evaluations - 1):
        if not np.all(np.isfinite(square)):
            return q
        box, energy = (np.maximum(lower - q, -reach * units), np.minimum(upper - q, reach * units)), square[-1, -1]
        beyond, step, expected = _least(square, beyond, box, 0.1 * tolerance * energy)
        if expected <= 0.1 * tolerance * energy:
            return q
        at = np.clip(q + step, lower, upper)
        there = products(at)
        fall = float(energy - there[-1, -1]) if np.all(np.isfinite(there)) else -np.inf
        refused = 0 if fall > 0.0 else refused + 1
        if refused == _REFUSED:
            units = np.where(np.isinf(units), np.maximum(np.abs(step), 1.0) / reach, units)
        used, before = float(np.max(np.abs(step) / units)), reach
        reach, beyond = _next_reach(reach, used, fall / expected), _beyond(square, beyond, there, step, fall / expected)
        if fall > 0.0:
            q, square = at, there
            ends = tolerance * energy if used < _AT_REACH * before else _LIMITED * tolerance * energy
            if _POOR * expected < fall < ends:
                return q
        elif used < _LEAST_STEP and np.all(np.isfinite(units)):
            return q
    return q


def _next_reach(reach: float, used: float, fall: float) -> float:
    """Half-width of the next box, from the part of it that a step took, and its fall over the expected one."""
    if fall < _POOR:
        return _SMALLER * (used or reach)
    return _LARGER * reach if fall > _GOOD and used > _AT_REACH * reach else reach


def _beyond(square: Mat, beyond: Mat | None, there: Mat, step: Vec, fall: float) -> Mat | None:
    """Linearisation on the other side of a kink, after a step with its fall over the expected one; None without one.

    A step that is poor may have crossed a kink: behind it lies the linearisation that it left, or did not take.
    """
    if fall <= 0.0:
        return _seen_from(there, -step) if np.isfinite(fall) else beyond
    left = _seen_from(square, step)
    if beyond is None or fall < _POOR:
        return left if fall < _POOR else None
    return _other(there, left, _seen_from(beyond, step))


def _least(square: Mat, beyond: Mat | None, box: tuple[Vec, Vec], enough: float) -> tuple[Mat | None, Vec, float]:
    """Step (Q,) of least error and its expected fall; a second linearisation is left where both expect too little."""
    step, lowest = _step_of(square, beyond, box)
    if beyond is not None and square[-1, -1] - lowest <= enough:
        return _least(square, None, box, enough)
    return beyond, step, float(square[-1, -1] - lowest)


def _seen_from(square: Mat, away: Vec) -> Mat:
    """Products of (J, r) with r as linearised at another point, which lies `away` (Q,) from theirs."""
    moved = np.eye(away.size + 1)
    moved[:-1, -1] = away
    return np.asarray(moved.T @ square @ moved)


def _other(here: Mat, one: Mat, two: Mat) -> Mat:
    """That of two linearisations whose derivatives of the error differ more from those here."""
    return max((one, two), key=lambda square: float(np.sum((square - here)[:-1, -1] ** 2)))


def _step_of(square: Mat, beyond: Mat | None, box: tuple[Vec, Vec]) -> tuple[Vec, float]:
    """Step (Q,) of least error in a box, and that error; with a second linearisation, of the greater of both errors."""

    def errors(part: float) -> tuple[Vec, float, float]:
        step = _step(square if beyond is None else (1 - part) * square + part * beyond, *box)
        both = np.append(step, 1.0)
        here = float(both @ square @ both)
        return step, here, here if beyond is None else float(both @ beyond @ both)

    step, here, there = errors(0.0)
    if there <= here:
        return step, here
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        part = 0.5 * (low + high)
        step, here, there = errors(part)
        low, high = (part, high) if there > here else (low, part)
    return step, max(here, there)


def _step(square: Mat, low: Vec, high: Vec) -> Vec:
    """Step (Q,) of least linearised error between low and high (Q,); none where the engine finds none."""
    norms = np.sqrt(np.maximum(np.diag(square)[:-1], _LEAST_NORM))
    correlation = square[:-1, :-1] / np.outer(norms, norms) + _JITTER * np.eye(norms.size)
    rows, room = norms.size, np.empty(engine().qp_bytes(norms.size, norms.size, 0), dtype=np.uint8)
    scaled, hard = np.zeros(rows), np.zeros(rows)
    ends = low * norms, high * norms
    program = correlation, square[:-1, -1] / norms, np.eye(rows), *ends, hard
    answer = engine().quadratic_program(rows, rows, *program, _CHANGES * rows, room, scaled)
    return np.clip(scaled / norms, low, high) if answer >= 0 else np.zeros(rows)

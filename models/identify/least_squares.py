"""Bounded least squares on free runs with exact sensitivities: of a chain to trials, and of a hypothesis to runs."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Mat, Vec

from ..chain import Chain
from ..decades import Decades
from ..model import FitProgress
from .chain_fit import (
    ChainFit,
    ChainTask,
    ConvergenceReport,
    FreeParameters,
    chain_from,
    in_log_units,
    nothing_found,
    told_in_log_units,
)
from .free_run import FreeRuns
from .problem import Problem
from .runs import AS_IT_IS, Run, RunsTogether

P = ParamSpec("P")
R = TypeVar("R")

RESTART_SPREAD = 0.2
_STARTS_FOUND = 2  # times that trials which begin in motion are given another start

_EDGE = 1e-9
_JITTER = 1e-13
_DIVERGED = 1e9
_MANY = 10_000  # samples
_FAR, _STEEP = 1e6, 1e100  # residual and derivative in working units of a run that diverged; both can be squared
_COMMON = 1.0  # of the samples, that the mean of the trials' own terms counts as
_HELD = 1e-10  # of the greatest curvature: what no run determines stays where it began


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """The function on one BLAS thread.

    The products of a fit are tall and narrow: with two threads a diagnosis took up to seven times the processor time.
    """

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@dataclass(frozen=True)
class OperatorFitSettings:
    """Settings of a least-squares fit of a chain.

    Attributes:
        skip_first_flexure: score each trial from the first reversal of its command on.
        offset_free: let each trial have an offset of its own, which the chain does not keep; for devices that are
            mounted anew between trials.
        evaluations: greatest number of free runs over all trials, for each start.
        tolerance: relative change of the loss at which a start is done.
        restarts: further starts around the best point so far; the error has kinks, where a start may get stuck.
        seed: of the restarts.
        lead_s: start of each trial that is not scored [s].
    """

    skip_first_flexure: bool = False
    offset_free: bool = False
    evaluations: int = 200
    tolerance: float = 1e-9
    restarts: int = 6
    seed: int = 0
    lead_s: float = 0.0


def fit_chain(
    starts: Sequence[Chain],
    trials: Sequence[Trial],
    settings: OperatorFitSettings | None = None,
    progress: FitProgress | None = None,
    fixed: Sequence[str] = (),
) -> ChainFit:
    """Fit the parameters of a chain from several starts; the best wins.

    Trust-region reflective least squares within the parameters' bounds, on the free-run error, in working units
    (`Decades`). An iteration of the report is a free run over all trials, its budget that of all starts together.

    Args:
        starts: chains of one structure; their values are the starting points.
        trials: uniformly sampled at one rate, in one unit.
        settings: see `OperatorFitSettings`.
        progress: called with the evaluations so far and the best rmse [deg]; KeyboardInterrupt ends the fit and
            keeps the best so far.
        fixed: names of parameters that stay as they are in the first start.

    Raises:
        FitError: on unusable trials, an unknown name, or if no start leads to a finite error.
    """
    decades = Decades.of(trials)
    output = decades.output(trials)
    fit = _fitted(
        [decades.chain(start) for start in starts],
        decades.trials(trials),
        settings or OperatorFitSettings(),
        told_in_log_units(progress, output),
        fixed,
    )
    return in_log_units(fit, decades, output)


def _fitted(
    starts: Sequence[Chain],
    trials: Sequence[Trial],
    settings: OperatorFitSettings,
    progress: FitProgress | None,
    fixed: Sequence[str],
) -> ChainFit:
    free = FreeParameters.of(starts[0], fixed)
    runs = FreeRuns(starts[0], trials, settings.skip_first_flexure, settings.offset_free, settings.lead_s)
    search, interrupted = _ChainSearch(runs, free, progress), False

    def minimise(start: Vec) -> None:
        _minimise(
            search.evaluate,
            np.clip(free.part(start), *free.bounds),
            free.bounds,
            x_scale="jac",
            ftol=settings.tolerance,
            xtol=1e-10,
            max_nfev=settings.evaluations,
        )

    try:
        for start in _points(starts, search, settings):
            minimise(start)
        for _ in range(_STARTS_FOUND if runs.in_motion and search.best is not None else 0):
            search.from_found_starts()
            minimise(np.asarray(search.best))
    except KeyboardInterrupt:
        interrupted = True
    if search.best is None:
        raise nothing_found(f"{len(search.losses)} free runs", interrupted)
    budget = settings.evaluations * (len(starts) + settings.restarts)
    report = ConvergenceReport("least_squares", tuple(search.losses), len(search.losses), budget)
    return ChainFit(chain_from(starts[0], search.best), search.best_rmse, report.evaluations, report, interrupted)


def fit_by_least_squares(
    task: ChainTask, settings: OperatorFitSettings, progress: FitProgress | None = None
) -> ChainFit:
    """`fit_chain` of a task, as the methods' table has it."""
    settings = replace(settings, lead_s=max(settings.lead_s, task.lead_s))
    return fit_chain(task.starts, task.trials, settings, progress, task.fixed)


def _points(starts: Sequence[Chain], search: _ChainSearch, settings: OperatorFitSettings) -> Iterator[Vec]:
    """The given starts, then the best point so far with every parameter changed by a fifth or so."""
    yield from (start.values for start in starts)
    rng = np.random.default_rng(settings.seed)
    for _ in range(settings.restarts):
        if search.best is not None:
            yield search.best * np.exp(rng.normal(0.0, RESTART_SPREAD, search.best.size))


class _ChainSearch:
    """Residuals and Jacobian by the free parameters; remembers the best point, all parameters in it."""

    def __init__(self, runs: FreeRuns, free: FreeParameters, progress: FitProgress | None) -> None:
        self._runs, self._free, self._progress = runs, free, progress
        self.best: Vec | None = None
        self.best_rmse = np.inf
        self.losses: list[float] = []

    def from_found_starts(self) -> None:
        """Let trials that begin in motion begin where the best chain so far finds them; errors count anew."""
        if self.best is not None:
            self._runs.find_starts(self.best)
            self.best_rmse = np.inf

    def evaluate(self, q: Vec) -> tuple[Vec, Mat]:
        p = self._free.full(q)
        residuals, jacobian = self._runs.residuals(p)
        with np.errstate(over="ignore"):  # a free run may diverge
            rmse = float(np.sqrt(np.sum(residuals**2)))
        if rmse < self.best_rmse:
            self.best, self.best_rmse = p, rmse
        self.losses.append(self.best_rmse**2)
        if self._progress:
            self._progress(len(self.losses), self.best_rmse)
        residuals = np.clip(np.nan_to_num(residuals, nan=_FAR), -_FAR, _FAR)
        jacobian = np.clip(np.nan_to_num(jacobian[:, self._free.index]), -_STEEP, _STEEP)
        return _condensed(residuals, jacobian)


def _condensed(residuals: Vec, jacobian: Mat) -> tuple[Vec, Mat]:
    """Where there are many samples, the triangle of a QR factorisation of (J, r), which least squares sees as the same.

    The solver's own decomposition of a Jacobian of ten thousand samples would cost more than the free runs.
    """
    if residuals.size < _MANY or not np.all(np.abs(jacobian) < _DIVERGED):
        return residuals, jacobian
    triangle = np.asarray(np.linalg.qr(np.column_stack([jacobian, residuals]), mode="r"))
    return triangle[:, -1], triangle[:, :-1]


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """Where a fit of a hypothesis ended.

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
    q = _minimise(
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
    """Errors and derivatives of all runs, condensed: the triangle R of a QR factorisation of (J, r).

    Least squares needs no more than the norm of r, J^T r and the singular values of J, and R has them all; with ten
    thousand samples the solver's own decompositions would cost more than the free runs.
    """

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
        """What the distance from the start and roughness add to the products of derivatives and errors."""
        away = np.column_stack([np.eye(q.size), q - self._start])
        rough = np.column_stack([self._problem.roughness, self._problem.roughness @ q])
        return np.asarray(_HELD * np.max(np.diag(square)[:-1], initial=0.0) * away.T @ away + rough.T @ rough)


def _triangle(square: Vec) -> Vec:
    """R with R^T R = square; a run that is not finite counts as a very bad one without a direction."""
    size = square.shape[0]
    if not np.all(np.isfinite(square)):
        return np.vstack([np.zeros((size - 1, size)), np.append(np.zeros(size - 1), _DIVERGED)[None]])
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    correlation = square / np.outer(scale, scale) + _JITTER * np.eye(size)
    return np.asarray(np.linalg.cholesky(correlation).T * scale, dtype=np.float64)


def _minimise(evaluate: Callable[[Vec], tuple[Vec, Mat]], start: Vec, bounds: tuple[Vec, Vec], **options: Any) -> Vec:
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

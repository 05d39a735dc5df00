"""Bounded least squares on free runs with exact sensitivities: of chains to trials, and of hypotheses to runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

from hystmpc.trials.errors import FitError, ModelError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..kernels.chain_kernels import compile_step
from ..symbolic.instructions import dense
from .chain_fit import FreeParameters, nothing_found
from .free_run import scored_runs
from .problem import Problem
from .runs import Run
from .trial_set import check_trial_set

Progress = Callable[[int, float], None]
RESTART_SPREAD = 0.2


@dataclass(frozen=True)
class OperatorFitSettings:
    """Settings of a least-squares fit.

    Attributes:
        skip_first_flexure: score each trial from the first reversal of its command on.
        offset_free: let each trial have an offset of its own, which the chain does not keep; for devices that are
            mounted anew between trials.
        evaluations: greatest number of free runs over all trials, for each start.
        tolerance: relative change of the loss at which a start is done.
        restarts: further starts around the best point so far; the error has kinks, where a start may get stuck.
        seed: of the restarts.
    """

    skip_first_flexure: bool = False
    offset_free: bool = False
    evaluations: int = 200
    tolerance: float = 1e-9
    restarts: int = 6
    seed: int = 0


@dataclass(frozen=True)
class OperatorFit:
    """Result of an identification.

    Attributes:
        chain: the best chain found.
        rmse_deg: root of the mean over trials of the mean square error [deg].
        starts: rmse [deg] that each start reached.
        evaluations: free runs over all trials.
        interrupted: stopped by the user; `chain` is the best so far.
    """

    chain: Chain
    rmse_deg: float
    starts: tuple[float, ...]
    evaluations: int
    interrupted: bool = False


class FreeRunResiduals:
    """Residuals and Jacobian of a chain's free runs over trials, each trial with equal weight.

    r = (theta(p) - measured) / sqrt(T_trial n_trials), so that sum r^2 is the mean over trials of the mean square
    error [deg^2]. Initial states follow the chain's rule from the first command and angle, their dependence on the
    parameters included.
    """

    def __init__(self, chain: Chain, trials: Sequence[Trial], settings: OperatorFitSettings) -> None:
        self._dt = np.array([check_trial_set(trials)])
        self._kernels = compile_step(chain.transition)
        self._settings = settings
        self._rest = rest_with_slope(chain)
        self._runs = scored_runs(chain, trials, settings.skip_first_flexure)

    def __call__(self, p: Vec) -> tuple[Vec, Vec]:
        """Residuals (R,) and Jacobian (R, P) at parameters p (P,)."""
        residuals, jacobians = [], []
        for run in self._runs:
            state, slope = self._rest(run.angle[0], run.commands[0], p)
            theta, gradient = np.empty(run.commands.size), np.empty((run.commands.size, p.size))
            self._kernels.differentiate(
                np.asarray(state).ravel(),
                np.ascontiguousarray(slope),
                run.commands,
                p,
                self._dt,
                self._kernels.sensitivity_constants,
                theta,
                gradient,
            )
            error = run.error(theta, self._settings.offset_free)
            by_p = gradient[-error.size :]
            if self._settings.offset_free:
                by_p = by_p - by_p.mean(axis=0)
            scale = 1 / np.sqrt(error.size * len(self._runs))
            residuals.append(error * scale)
            jacobians.append(by_p * scale)
        return np.concatenate(residuals), np.vstack(jacobians)


def fit_chain(
    starts: Sequence[Chain],
    trials: Sequence[Trial],
    settings: OperatorFitSettings | None = None,
    progress: Progress | None = None,
    fixed: Sequence[str] = (),
) -> OperatorFit:
    """Fit the parameters of a chain from several starts; the best wins.

    Trust-region reflective least squares within the parameters' physical bounds, on the free-run error.

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
    settings = settings or OperatorFitSettings()
    free = FreeParameters.of(starts[0], fixed)
    search = _ChainSearch(FreeRunResiduals(starts[0], trials, settings), free, progress)
    bounds = free.bounds
    reached, interrupted = [], False
    try:
        for start in _points(starts, search, settings):
            search.begin()
            least_squares(
                search.residuals,
                np.clip(free.part(start), *bounds),
                cast(Any, search.jacobian),  # SciPy is untyped: pyright takes `jac` for a string, as its default is
                bounds=bounds,
                x_scale="jac",
                ftol=settings.tolerance,
                xtol=1e-10,
                max_nfev=settings.evaluations,
            )
            reached.append(search.reached)
    except KeyboardInterrupt:
        interrupted = True
    if search.best is None:
        raise nothing_found(f"{search.evaluations} free runs", interrupted)
    try:
        chain = starts[0].with_values(search.best.tolist())
    except ModelError as error:
        raise FitError(f"the fit ended at an unusable model: {error}") from None
    return OperatorFit(chain, search.best_rmse, tuple(reached), search.evaluations, interrupted)


def _points(starts: Sequence[Chain], search: _ChainSearch, settings: OperatorFitSettings) -> Iterator[Vec]:
    """The given starts, then the best point so far with every parameter changed by a fifth or so."""
    yield from (start.values for start in starts)
    rng = np.random.default_rng(settings.seed)
    for _ in range(settings.restarts):
        if search.best is not None:
            yield search.best * np.exp(rng.normal(0.0, RESTART_SPREAD, search.best.size))


class _ChainSearch:
    """The objective as scipy wants it: residuals and Jacobian apart, computed once; remembers the best point.

    Its arguments are the free parameters, `best` has all of them.
    """

    def __init__(self, problem: FreeRunResiduals, free: FreeParameters, progress: Progress | None) -> None:
        self._problem, self._free, self._progress = problem, free, progress
        self._at: Vec | None = None
        self._jacobian: Vec = np.empty((0, 0))
        self.best: Vec | None = None
        self.best_rmse = self.reached = np.inf
        self.evaluations = 0

    def begin(self) -> None:
        """Forget what the last start reached."""
        self.reached = np.inf

    def residuals(self, q: Vec) -> Vec:
        self._at, p = q.copy(), self._free.full(q)
        residuals, jacobian = self._problem(p)
        self._jacobian = jacobian[:, self._free.index]
        self.evaluations += 1
        rmse = float(np.sqrt(np.sum(residuals**2)))
        if np.isfinite(rmse):
            self.reached = min(self.reached, rmse)
            if rmse < self.best_rmse:
                self.best, self.best_rmse = p, rmse
        if self._progress:
            self._progress(self.evaluations, self.best_rmse)
        return np.nan_to_num(residuals, nan=1e6, posinf=1e6, neginf=-1e6)

    def jacobian(self, q: Vec) -> Vec:
        if self._at is None or not np.array_equal(q, self._at):
            self.residuals(q)
        return np.nan_to_num(self._jacobian)


def rest_with_slope(chain: Chain) -> Any:
    """CasADi function (y, u, p) -> initial state (S,1) and its derivative by p (S, P)."""
    y, u, p = ca.SX.sym("y"), ca.SX.sym("u"), ca.SX.sym("p", len(chain.parameters))
    state = chain.rest(y, u, p)
    return dense("rest", [y, u, p], [state, ca.jacobian(state, p)])


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


def fit_problem(
    problem: Problem, runs: Sequence[Run], start: Vec, evaluations: int = 25, tolerance: float = 1e-4
) -> Fit:
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

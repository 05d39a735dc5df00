"""Identification of operator chains: bounded least squares on free runs with exact sensitivities."""

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
from ..kernels.program import dense
from .chain_fit import nothing_found
from .free_parameters import FreeParameters
from .free_run import scored_runs
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
    search = _Search(FreeRunResiduals(starts[0], trials, settings), free, progress)
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


def _points(starts: Sequence[Chain], search: _Search, settings: OperatorFitSettings) -> Iterator[Vec]:
    """The given starts, then the best point so far with every parameter changed by a fifth or so."""
    yield from (start.values for start in starts)
    rng = np.random.default_rng(settings.seed)
    for _ in range(settings.restarts):
        if search.best is not None:
            yield search.best * np.exp(rng.normal(0.0, RESTART_SPREAD, search.best.size))


class _Search:
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

"""Identification of operator chains: bounded least squares on free runs with exact sensitivities."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from hystmpc.trials.errors import FitError, ModelError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial

from ..chain import Chain
from ..kernels.chain_kernels import compile_step
from ..symbolic.instructions import dense
from .trial_set import check_trial_set

Vec = NDArray[np.float64]
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
        self._warmup = chain.settling_samples
        self._rest = _rest_with_slope(chain)
        self._runs = []
        for trial in trials:
            start = first_flexure_end(trial) if settings.skip_first_flexure else 0
            commands = np.concatenate([np.full(self._warmup, trial.command[0]), trial.command])
            scale = 1 / np.sqrt((len(trial) - start) * len(trials))
            self._runs.append((commands, trial.command[0], trial.angle, start, scale))

    def __call__(self, p: Vec) -> tuple[Vec, Vec]:
        """Residuals (R,) and Jacobian (R, P) at parameters p (P,)."""
        residuals, jacobians = [], []
        for commands, rest_u, angle, start, scale in self._runs:
            state, slope = self._rest(angle[0], rest_u, p)
            theta, gradient = np.empty(commands.size), np.empty((commands.size, p.size))
            self._kernels.differentiate(
                np.asarray(state).ravel(),
                np.ascontiguousarray(slope),
                commands,
                p,
                self._dt,
                self._kernels.sensitivity_constants,
                theta,
                gradient,
            )
            first = self._warmup + start
            error, by_p = theta[first:] - angle[start:], gradient[first:]
            if self._settings.offset_free:
                error, by_p = error - error.mean(), by_p - by_p.mean(axis=0)
            residuals.append(error * scale)
            jacobians.append(by_p * scale)
        return np.concatenate(residuals), np.vstack(jacobians)


def fit_chain(
    starts: Sequence[Chain],
    trials: Sequence[Trial],
    settings: OperatorFitSettings | None = None,
    progress: Progress | None = None,
) -> OperatorFit:
    """Fit the parameters of a chain from several starts; the best wins.

    Trust-region reflective least squares within the parameters' physical bounds, on the free-run error.

    Args:
        starts: chains of one structure; their values are the starting points.
        trials: uniformly sampled at one rate, in one unit.
        settings: see `OperatorFitSettings`.
        progress: called with the evaluations so far and the best rmse [deg]; KeyboardInterrupt ends the fit and
            keeps the best so far.

    Raises:
        FitError: on unusable trials, or if no start leads to a finite error.
    """
    settings = settings or OperatorFitSettings()
    search = _Search(FreeRunResiduals(starts[0], trials, settings), progress)
    bounds = (np.array([p.lower for p in starts[0].parameters]), np.array([p.upper for p in starts[0].parameters]))
    reached, interrupted = [], False
    try:
        for start in _points(starts, search, settings):
            search.begin()
            least_squares(
                search.residuals,
                np.clip(start, *bounds),
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
        raise FitError(f"no finite error in {search.evaluations} free runs, expected at least one; check the units")
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
    """The objective as scipy wants it: residuals and Jacobian apart, computed once; remembers the best point."""

    def __init__(self, problem: FreeRunResiduals, progress: Progress | None) -> None:
        self._problem, self._progress = problem, progress
        self._at: Vec | None = None
        self._jacobian: Vec = np.empty((0, 0))
        self.best: Vec | None = None
        self.best_rmse = self.reached = np.inf
        self.evaluations = 0

    def begin(self) -> None:
        """Forget what the last start reached."""
        self.reached = np.inf

    def residuals(self, p: Vec) -> Vec:
        self._at = p.copy()
        residuals, self._jacobian = self._problem(p)
        self.evaluations += 1
        rmse = float(np.sqrt(np.sum(residuals**2)))
        if np.isfinite(rmse):
            self.reached = min(self.reached, rmse)
            if rmse < self.best_rmse:
                self.best, self.best_rmse = p.copy(), rmse
        if self._progress:
            self._progress(self.evaluations, self.best_rmse)
        return np.nan_to_num(residuals, nan=1e6, posinf=1e6, neginf=-1e6)

    def jacobian(self, p: Vec) -> Vec:
        if self._at is None or not np.array_equal(p, self._at):
            self.residuals(p)
        return np.nan_to_num(self._jacobian)


def _rest_with_slope(chain: Chain) -> ca.Function:
    """CasADi function (y, u, p) -> initial state (S,1) and its derivative by p (S, P)."""
    y, u, p = ca.SX.sym("y"), ca.SX.sym("u"), ca.SX.sym("p", len(chain.parameters))
    state = chain.rest(y, u, p)
    return dense("rest", [y, u, p], [state, ca.jacobian(state, p)])

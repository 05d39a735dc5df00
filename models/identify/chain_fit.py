"""Fit of one chain to trials: by bounded least squares, or by a method of an installed package."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import FitError, FitInterruptedError, ModelError, did_you_mean
from hystmpc.trials.from_outside import installed_objects
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Mat, Vec

from ..chain import Chain
from ..decades import Decades
from ..model import FitProgress
from ..operators.operator import Operator
from .chain_kinds import CHAIN_KINDS, Ends, Extent
from .free_run import FreeRuns
from .least_squares import condensed, minimise
from .runs import check_trial_set

GROUP = "hystmpc.methods"
"""Entry points by which installed packages add a method; the value is MODULE:NAME of an `IdentificationMethod`."""

TAIL = 0.1
RESTART_SPREAD = 0.2
_START_SEARCHES = 2  # number of new start estimates for trials that begin in motion
_FAR, _STEEP = 1e6, 1e100  # residual and derivative in working units of a run that diverged; both can be squared


@dataclass(frozen=True)
class ConvergenceReport:
    """Loss of a fit by iteration, as the method counts iterations.

    Attributes:
        losses: loss after each iteration, in the square of the output's unit; not empty. For methods whose loss may
            rise (trials of steps, generations), the best so far.

    Source: S1 Table IV.
    """

    method: str
    losses: tuple[float, ...]
    evaluations: int
    budget: int

    @property
    def iterations(self) -> int:
        """Number of iterations done."""
        return len(self.losses)

    @property
    def loss(self) -> float:
        """Loss after the last iteration."""
        return self.losses[-1]

    @property
    def mean_relative_change(self) -> float:
        """Mean of |L_k - L_{k-1}| / L_{k-1} over the last tenth of the iterations; not a number below two of them."""
        last = self.losses[-max(1, round(TAIL * self.iterations)) - 1 :]
        changes = [abs(b - a) / a for a, b in itertools.pairwise(last) if a > 0]
        if len(last) < 2:
            return math.nan
        return sum(changes) / (len(last) - 1)

    def line(self) -> str:
        """Convergence in one line for reports."""
        return (
            f"{self.method}: {self.iterations} of {self.budget} iterations, {self.evaluations} evaluations, "
            f"loss {self.loss:.4g}, mean relative change over the last tenth {100 * self.mean_relative_change:.3g} %"
        )


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """Parameters of a chain that a fit may change.

    Attributes:
        values: values of all (P,), the fixed ones included.
        index: positions of the free ones (Q,).
        bounds: physical lower and upper bounds of the free ones (Q,) each.
    """

    values: Vec
    index: NDArray[np.intp]
    bounds: tuple[Vec, Vec]

    @classmethod
    def of(cls, chain: Chain, fixed: Sequence[str]) -> Self:
        """All parameters except those named.

        Raises:
            FitError: if a name is not one of the chain's.
        """
        names = [p.name for p in chain.parameters]
        for name in fixed:
            if name not in names:
                raise FitError(f"no parameter {name!r} to hold fixed, {did_you_mean(name, names)}")
        index = np.flatnonzero([name not in fixed for name in names])
        lower, upper = (np.array([getattr(p, end) for p in chain.parameters]) for end in ("lower", "upper"))
        return cls(chain.values, index, (lower[index], upper[index]))

    def part(self, p: Vec) -> Vec:
        """Free parameters (Q,) of all parameters (P,)."""
        return np.asarray(p)[self.index]

    def full(self, q: Vec) -> Vec:
        """All parameters (P,) from the free ones (Q,)."""
        p = self.values.copy()
        p[self.index] = q
        return p


@dataclass(frozen=True, eq=False)
class ChainTask:
    """Identification problem of a chain: starting points, search region, fixed parameters and trials.

    Attributes:
        starts: chains of one structure; their values are the starting points.
        box: lower and upper end of the region of a global search (P,) each, within the physical bounds.
        first: lower and upper end of its initial region.
        fixed: names of parameters that are set, not identified.
        lead_s: start of each trial that least squares does not score [s]: a device that rings may be in motion.
    """

    starts: tuple[Chain, ...]
    box: tuple[Vec, Vec]
    first: tuple[Vec, Vec]
    fixed: tuple[str, ...]
    trials: tuple[Trial, ...]
    lead_s: float = 0.0

    @property
    def free(self) -> FreeParameters:
        """Parameters that a method may change."""
        return FreeParameters.of(self.starts[0], self.fixed)


def chain_task(kind: str, trials: Sequence[Trial], plays: int = 4) -> ChainTask:
    """Identification problem of a kind of chain.

    Args:
        kind: a name of `CHAIN_KINDS`; with `inverse_` before it, the inverse map, identified as its own model (the
            "fitted inverse" of S2).
        trials: command to angle for forward kinds; swapped (`Trial.swapped`) for the inverse ones.
        plays: number of plays of a `pi` or `drdpi`, or of sliders.

    Raises:
        FitError: on an unknown kind, trials swapped wrongly, unusable trials, or less than one play.
    """
    known = [*CHAIN_KINDS, *(f"inverse_{name}" for name, entry in CHAIN_KINDS.items() if entry.inverse)]
    if kind not in known:
        raise FitError(f"no kind of chain {kind!r}, {did_you_mean(kind, known)}")
    if plays < 1:
        raise FitError(f"{plays} plays, expected at least one")
    check_trial_set(trials)
    entry = CHAIN_KINDS[kind.removeprefix("inverse_")]
    inverse = entry.inverse if kind.startswith("inverse_") else None
    if trials[0].inverted != (inverse is not None):
        way = "angle to command" if inverse else "command to angle"
        raise FitError(f"{kind} maps {way}, got trials with the command in {trials[0].units.command}; swap them")
    forward = [trial.swapped() if trial.inverted else trial for trial in trials]
    extent = Extent.of(forward, entry)
    operators = entry.starts(forward, extent, plays)
    if inverse:
        operators = [inverse(operator) for operator in operators]
    box = entry.box(extent, plays)
    ends, first = (_ends(operators[0], {**box, **narrower}) for narrower in ({}, entry.first(extent, plays)))
    fixed = entry.inverse_fixed if inverse else entry.fixed
    lead_s = extent.ringing.lead_s if extent.ringing else 0.0
    return ChainTask(tuple(map(Chain, operators)), ends, first, fixed, tuple(trials), lead_s)


def _ends(operator: Operator, box: Ends) -> tuple[Vec, Vec]:
    """Search region in the order of the operator's parameters; a parameter without an entry is fixed."""
    rows = []
    for parameter, value in zip(operator.parameters, operator.values, strict=True):
        stem = parameter.name.rstrip("0123456789")
        low, high = box.get(parameter.name, box.get(stem, (value, value)))
        rows.append((max(low, parameter.lower), min(high, parameter.upper)))
    lower, upper = np.array(rows).T
    return lower, upper


@dataclass(frozen=True)
class ChainFit:
    """Result of an identification by any method.

    Attributes:
        rmse_deg: root of the mean over trials of the mean square error of its free runs [deg; mm or bar for an inverse
            map], which compares methods of any loss.
    """

    chain: Chain
    rmse_deg: float
    evaluations: int
    report: ConvergenceReport
    interrupted: bool = False


class Tracker:
    """Loss function that records its best point and its progress, for a method that may be stopped at any time."""

    def __init__(self, loss: Callable[[Vec], float], free: FreeParameters, progress: FitProgress | None) -> None:
        self._loss, self._free, self._progress = loss, free, progress
        self.best: Vec | None = None
        self.best_loss = np.inf
        self.evaluations = 0
        self.losses: list[float] = []

    def __call__(self, q: Vec) -> float:
        """Loss at the free parameters q (Q,)."""
        p = self._free.full(q)
        return self.note(p, self._loss(p))

    def note(self, p: Vec, loss: float) -> float:
        """Record the loss at all parameters p (P,) and return it."""
        self.evaluations += 1
        if loss < self.best_loss:
            self.best, self.best_loss = p, loss
        return loss

    def iteration(self, loss: float | None = None) -> None:
        """End an iteration: record its loss, None for the best so far, and report the root of the best loss."""
        self.losses.append(float(self.best_loss if loss is None else loss))
        if self._progress:
            self._progress(len(self.losses), float(np.sqrt(self.best_loss)))

    def report(self, method: str, budget: int) -> ConvergenceReport:
        """Convergence so far; a stopped first iteration is counted."""
        losses = tuple(self.losses) or (float(self.best_loss),)
        return ConvergenceReport(method, losses, self.evaluations, budget)

    def chain(self, template: Chain, interrupted: bool = False) -> Chain:
        """Best chain so far; the final one if the user ended the fit.

        Raises:
            FitError: if no point had a finite loss, or the best one is unusable.
        """
        if self.best is None:
            raise no_result(f"{self.evaluations} free runs", interrupted)
        try:
            return template.with_values(self.best.tolist())
        except ModelError as error:
            raise FitError(f"the fit ended at an unusable model: {error}") from None


def no_result(looked_at: str, interrupted: bool) -> FitError:
    """Error of a fit without a best point: interrupted at once, or no finite error."""
    if interrupted:
        return FitInterruptedError("the fit was interrupted before its first look, there is nothing to keep")
    return FitError(f"no finite error in {looked_at}, expected at least one; check the units")


Fit = Callable[[ChainTask, Any, FitProgress | None], ChainFit]


@dataclass(frozen=True)
class IdentificationMethod:
    """Method to identify a chain.

    Attributes:
        trainings: training that selects the method, by kind of chain.
        kinds: kinds of chain that it can identify; None for all.
    """

    name: str
    settings: type[Any]
    fit: Fit
    trainings: Mapping[str, str]
    summary: str
    kinds: tuple[str, ...] | None = None

    def settings_for(self, steps: int | None, seed: int, skip_first_flexure: bool) -> Any:
        """Settings with a greatest number of steps (free runs, epochs, iterations), None for the method's default."""
        known = {f.name for f in fields(self.settings)}
        count = next(name for name in ("evaluations", "epochs", "iterations") if name in known)
        chosen = {"seed": seed, "skip_first_flexure": skip_first_flexure} | ({count: steps} if steps else {})
        return self.settings(**{name: value for name, value in chosen.items() if name in known})


@dataclass(frozen=True)
class OperatorFitSettings:
    """Settings of a least-squares fit of a chain.

    Attributes:
        skip_first_flexure: score each trial from the first reversal of its command on.
        evaluations: greatest number of free runs over all trials, for each start.
        tolerance: relative change of the loss at which the fit from one start ends.
        restarts: further starts around the best point so far; a fit may end at a kink of the error.
        seed: of the restarts.
    """

    skip_first_flexure: bool = False
    evaluations: int = 200
    tolerance: float = 1e-9
    restarts: int = 6
    seed: int = 0


def fit_chain(
    starts: Sequence[Chain],
    trials: Sequence[Trial],
    settings: OperatorFitSettings | None = None,
    progress: FitProgress | None = None,
    fixed: Sequence[str] = (),
) -> ChainFit:
    """Fit the parameters of a chain from several starts and return the best fit.

    Trust-region reflective least squares within the parameters' bounds, on the free-run error, in working units
    (`Decades`). An iteration of the report is a free run over all trials, its budget that of all starts together.

    Args:
        starts: chains of one structure; their values are the starting points.
        trials: uniformly sampled at one rate, in one unit.
        progress: called with the evaluations so far and the best rmse [deg]; KeyboardInterrupt keeps the best so far.
        fixed: names of parameters that stay as they are in the first start.

    Raises:
        FitError: on unusable trials, an unknown name, or if no start leads to a finite error.
    """
    decades, none = Decades.of(trials), (np.empty(0), np.empty(0))
    task = ChainTask(tuple(map(decades.chain, starts)), none, none, tuple(fixed), tuple(decades.trials(trials)))
    return _in_log_units(fit_by_least_squares, task, settings or OperatorFitSettings(), progress, decades)


def fit_by_least_squares(
    task: ChainTask, settings: OperatorFitSettings, progress: FitProgress | None = None
) -> ChainFit:
    """Identification method that applies `fit_chain` to a task in working units."""
    template, free = task.starts[0], task.free
    runs = FreeRuns(template, task.trials, settings.skip_first_flexure, task.lead_s)
    tracker, interrupted = Tracker(runs.mse, free, progress), False

    def evaluate(q: Vec) -> tuple[Vec, Mat]:
        p = free.full(q)
        residuals, jacobian = runs.residuals(p)
        with np.errstate(over="ignore"):  # a free run may diverge
            rmse = float(np.sqrt(np.sum(residuals**2)))
        tracker.note(p, rmse * rmse)
        tracker.iteration()
        residuals = np.clip(np.nan_to_num(residuals, nan=_FAR), -_FAR, _FAR)
        return condensed(residuals, np.clip(np.nan_to_num(jacobian[:, free.index]), -_STEEP, _STEEP))

    def fit_from(p: Vec) -> None:
        limits = {"ftol": settings.tolerance, "xtol": 1e-10, "max_nfev": settings.evaluations}
        minimise(evaluate, np.clip(free.part(p), *free.bounds), free.bounds, x_scale="jac", **limits)

    try:
        for start in _points(task.starts, tracker, settings):
            fit_from(start)
        for _ in range(_START_SEARCHES if runs.in_motion and tracker.best is not None else 0):
            best = np.asarray(tracker.best)
            runs.estimate_starts(best)
            tracker.best_loss = np.inf  # errors count from the new starts on
            fit_from(best)
    except KeyboardInterrupt:
        interrupted = True
    chain = tracker.chain(template, interrupted)
    report = tracker.report("least_squares", settings.evaluations * (len(task.starts) + settings.restarts))
    return ChainFit(chain, float(np.sqrt(tracker.best_loss)), report.evaluations, report, interrupted)


def _points(starts: Sequence[Chain], tracker: Tracker, settings: OperatorFitSettings) -> Iterator[Vec]:
    """Starting points: the given ones, then the best so far with every parameter changed by about a fifth."""
    yield from (start.values for start in starts)
    rng = np.random.default_rng(settings.seed)
    for _ in range(settings.restarts):
        if tracker.best is not None:
            yield tracker.best * np.exp(rng.normal(0.0, RESTART_SPREAD, tracker.best.size))


def _in_log_units(fit: Fit, task: ChainTask, settings: Any, progress: FitProgress | None, decades: Decades) -> ChainFit:
    """Fit of a task in working units; its chain, errors and progress are converted to log units."""
    output = decades.output(task.trials)
    tell = None if progress is None else lambda done, error: progress(done, error * output)
    made = fit(task, settings, tell)
    report = replace(made.report, losses=tuple(loss * output**2 for loss in made.report.losses))
    return replace(made, chain=decades.log_chain(made.chain), rmse_deg=made.rmse_deg * output, report=report)


LEAST_SQUARES = IdentificationMethod(
    "least_squares",
    OperatorFitSettings,
    fit_by_least_squares,
    dict.fromkeys(CHAIN_KINDS, "best"),
    "bounded least squares on free runs with exact sensitivities, from several starts",
)


@cache
def methods() -> Mapping[str, IdentificationMethod]:
    """Identification methods by name, those of installed packages last."""
    others = installed_objects(GROUP, "identification method", IdentificationMethod, [LEAST_SQUARES.name])
    return MappingProxyType({LEAST_SQUARES.name: LEAST_SQUARES, **others})


def methods_by_training(kind: str) -> Mapping[str, IdentificationMethod]:
    """Methods that can identify a kind of chain, by the name of the training, the default first."""
    return {method.trainings[kind]: method for method in methods().values() if kind in method.trainings}


def identify_chain(
    kind: str,
    trials: Sequence[Trial],
    method: str = "least_squares",
    settings: Any = None,
    plays: int = 4,
    progress: FitProgress | None = None,
) -> tuple[Chain, ChainFit]:
    """Identify a chain of a kind by one of the `methods`, and return the chain and the result.

    Args:
        kind: a name of `CHAIN_KINDS`; for swapped trials (`Trial.swapped`) `inverse_backlash`, `inverse_pi` or
            `inverse_drdpi`, which are identified directly.
        trials: uniformly sampled at one rate, in one pair of units.
        plays: number of plays of a `pi` or `drdpi`, or of sliders.
        progress: called with the iteration (for least squares: the free runs over all trials) and the best error so
            far; KeyboardInterrupt keeps the best so far.

    Raises:
        FitError: on an unknown kind or method, settings of another method, a kind that the method cannot identify,
            unusable trials, a missing extra, or no finite error.
    """
    if method not in methods():
        raise FitError(f"no identification method {method!r}, {did_you_mean(method, methods())}")
    chosen = methods()[method]
    settings = settings or chosen.settings()
    if not isinstance(settings, chosen.settings):
        raise FitError(f"{method}: got {type(settings).__name__}, expected {chosen.settings.__name__}")
    decades = Decades.of(trials)
    task = chain_task(kind, decades.trials(trials), plays)
    if chosen.kinds is not None and kind not in chosen.kinds:
        raise FitError(f"{method} cannot identify {kind!r}, {did_you_mean(kind, chosen.kinds)}")
    fit = _in_log_units(chosen.fit, task, settings, progress, decades)
    return fit.chain, fit

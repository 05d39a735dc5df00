"""What an identification method of a chain is given and gives back."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import FitError, FitInterruptedError, ModelError, did_you_mean
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..decades import Decades
from ..model import FitProgress

TAIL = 0.1


@dataclass(frozen=True)
class ConvergenceReport:
    """Loss by iteration of one training, whatever the method calls an iteration.

    Attributes:
        method: name of the method.
        losses: loss after each iteration, in the square of the output's unit; not empty. Methods that may get worse
            before they get better as a matter of course (trials of steps, generations) give their best so far.
        evaluations: passes over the training data.
        budget: iterations that were allowed.

    Source: S1 Table IV.
    """

    method: str
    losses: tuple[float, ...]
    evaluations: int
    budget: int

    @property
    def iterations(self) -> int:
        """Iterations done."""
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
        """One line for reports."""
        return (
            f"{self.method}: {self.iterations} of {self.budget} iterations, {self.evaluations} evaluations, "
            f"loss {self.loss:.4g}, mean relative change over the last tenth {100 * self.mean_relative_change:.3g} %"
        )


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """The free ones among a chain's parameters.

    Attributes:
        values: values of all (P,), from which the fixed ones are taken.
        index: positions of the free ones (Q,).
        bounds: physical lower and upper bounds of the free ones (Q,) each.
    """

    values: Vec
    index: NDArray[np.intp]
    bounds: tuple[Vec, Vec]

    @classmethod
    def of(cls, chain: Chain, fixed: Sequence[str]) -> Self:
        """All parameters but those named.

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
        """The free ones (Q,) of all parameters (P,)."""
        return np.asarray(p)[self.index]

    def full(self, q: Vec) -> Vec:
        """All parameters (P,) from the free ones (Q,)."""
        p = self.values.copy()
        p[self.index] = q
        return p


@dataclass(frozen=True, eq=False)
class ChainTask:
    """A chain to be identified: where to start, where to search, what to leave alone.

    Attributes:
        starts: chains of one structure; their values are the starting points.
        box: lower and upper end of the region that a global search covers (P,) each, within the physical bounds.
        first: the same of the region in which it begins.
        fixed: names of parameters that are set, not identified.
        trials: uniformly sampled at one rate, in one pair of units.
        lead_s: start of each trial that least squares does not score [s]: a device that rings may be found in motion.
    """

    starts: tuple[Chain, ...]
    box: tuple[Vec, Vec]
    first: tuple[Vec, Vec]
    fixed: tuple[str, ...]
    trials: tuple[Trial, ...]
    lead_s: float = 0.0

    @property
    def free(self) -> FreeParameters:
        """The parameters that a method may change."""
        return FreeParameters.of(self.starts[0], self.fixed)


@dataclass(frozen=True)
class ChainFit:
    """Result of an identification by any method.

    Attributes:
        chain: the best chain found.
        rmse_deg: root of the mean over trials of the mean square error of its free runs [deg; mm or bar for an inverse
            map]: the figure by which methods compare, whatever they minimised.
        evaluations: passes over the trials.
        report: how the method's own loss converged.
        interrupted: stopped by the user; `chain` is the best so far.
    """

    chain: Chain
    rmse_deg: float
    evaluations: int
    report: ConvergenceReport
    interrupted: bool = False


def in_log_units(fit: ChainFit, decades: Decades, output: float) -> ChainFit:
    """A fit that was made in working units, in those of the log.

    Args:
        found: the fit.
        decades: the working units.
        output: log units of one working unit of what the chain predicts.
    """
    report = replace(fit.report, losses=tuple(loss * output**2 for loss in fit.report.losses))
    return replace(fit, chain=decades.log_chain(fit.chain), rmse_deg=fit.rmse_deg * output, report=report)


def told_in_log_units(progress: FitProgress | None, output: float) -> FitProgress | None:
    """Progress whose errors arrive in working units; see `in_log_units`."""
    if progress is None:
        return None
    tell = progress
    return lambda done, error: tell(done, error * output)


class Tracker:
    """A loss that remembers its best point, for methods that keep no such record or may be stopped at any time."""

    def __init__(self, loss: Callable[[Vec], float], free: FreeParameters, progress: FitProgress | None) -> None:
        self._loss, self._free, self._progress = loss, free, progress
        self.best: Vec | None = None
        self.best_loss = np.inf
        self.evaluations = 0
        self.losses: list[float] = []

    def __call__(self, q: Vec) -> float:
        """Loss at the free parameters q (Q,)."""
        p = self._free.full(q)
        loss = self._loss(p)
        self.evaluations += 1
        if loss < self.best_loss:
            self.best, self.best_loss = p, loss
        return loss

    def iteration(self, loss: float | None = None) -> None:
        """End an iteration: record its loss, None for the best so far; tell the root of the best so far."""
        self.losses.append(float(self.best_loss if loss is None else loss))
        if self._progress:
            self._progress(len(self.losses), float(np.sqrt(self.best_loss)))

    def report(self, method: str, budget: int) -> ConvergenceReport:
        """The record so far; stopped within the first iteration, that one counts as it stands."""
        losses = tuple(self.losses) or (float(self.best_loss),)
        return ConvergenceReport(method, losses, self.evaluations, budget)

    def chain(self, template: Chain, interrupted: bool = False) -> Chain:
        """The best chain so far, the last one if the user ended the fit.

        Raises:
            FitError: if no point had a finite loss, or the best one is unusable.
        """
        if self.best is None:
            raise nothing_found(f"{self.evaluations} evaluations", interrupted)
        return chain_from(template, self.best)


def chain_from(template: Chain, values: Vec) -> Chain:
    """The chain with the values (P,) of a fit.

    Raises:
        FitError: if they are no usable model.
    """
    try:
        return template.with_values(values.tolist())
    except ModelError as error:
        raise FitError(f"the fit ended at an unusable model: {error}") from None


def nothing_found(looked_at: str, interrupted: bool) -> FitError:
    """Why there is no best point: the user was faster, or no error is a number."""
    if interrupted:
        return FitInterruptedError("the fit was interrupted before its first look, there is nothing to keep")
    return FitError(f"no finite error in {looked_at}, expected at least one; check the units")


Fit = Callable[[ChainTask, Any, FitProgress | None], ChainFit]


@dataclass(frozen=True)
class IdentificationMethod:
    """One way to identify a chain.

    Attributes:
        name: as it is asked for.
        settings: class of its settings, a frozen dataclass.
        fit: from task, settings and progress to the result.
        trainings: by kind of chain that has it, the training under which it has it.
        summary: one line for help texts.
        kinds: kinds of chain that it can identify; None for all.
    """

    name: str
    settings: type[Any]
    fit: Fit
    trainings: Mapping[str, str]
    summary: str
    kinds: tuple[str, ...] | None = None

    def settings_for(self, steps: int | None, seed: int, skip_first_flexure: bool) -> Any:
        """Its settings with a greatest number of steps (free runs, epochs, iterations), None for the default."""
        known = {f.name for f in fields(self.settings)}
        count = next(name for name in ("evaluations", "epochs", "iterations") if name in known)
        chosen = {"seed": seed, "skip_first_flexure": skip_first_flexure} | ({count: steps} if steps else {})
        return self.settings(**{name: value for name, value in chosen.items() if name in known})

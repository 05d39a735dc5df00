"""What every identification method of a chain is given and gives back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.errors import FitError, ModelError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from .convergence import ConvergenceReport
from .free_parameters import FreeParameters

Progress = Callable[[int, float], None]


@dataclass(frozen=True, eq=False)
class ChainTask:
    """A chain to be identified: where to start, where to search, what to leave alone.

    Attributes:
        starts: chains of one structure; their values are the starting points.
        box: lower and upper end of the region that a global search covers (P,) each, within the physical bounds.
        first: the same of the region in which it begins.
        fixed: names of parameters that are set, not identified.
        trials: uniformly sampled at one rate, in one pair of units.
    """

    starts: tuple[Chain, ...]
    box: tuple[Vec, Vec]
    first: tuple[Vec, Vec]
    fixed: tuple[str, ...]
    trials: tuple[Trial, ...]

    @property
    def free(self) -> FreeParameters:
        """The parameters that a method may change."""
        return FreeParameters.of(self.starts[0], self.fixed)


@dataclass(frozen=True)
class ChainFit:
    """Result of an identification by any method.

    Attributes:
        chain: the best chain found.
        rmse: root of the mean over trials of the mean square error of its free runs, in the unit of the output (deg;
            the command's for inverse maps): the figure by which methods compare, whatever they minimised.
        evaluations: passes over the trials.
        report: how the method's own loss converged.
        interrupted: stopped by the user; `chain` is the best so far.
    """

    chain: Chain
    rmse: float
    evaluations: int
    report: ConvergenceReport
    interrupted: bool = False


class Tracker:
    """A loss that remembers its best point, for methods that keep no such record or may be stopped at any time."""

    def __init__(self, loss: Callable[[Vec], float], free: FreeParameters, progress: Progress | None) -> None:
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
        try:
            return template.with_values(self.best.tolist())
        except ModelError as error:
            raise FitError(f"the fit ended at an unusable model: {error}") from None


def nothing_found(looked_at: str, interrupted: bool) -> FitError:
    """Why there is no best point: the user was faster, or no error is a number."""
    if interrupted:
        return FitError("the fit was interrupted before its first look, there is nothing to keep")
    return FitError(f"no finite error in {looked_at}, expected at least one; check the units")

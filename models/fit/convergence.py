"""How a training converged, in the figures of S1 Table IV."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

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

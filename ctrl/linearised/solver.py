"""What the linearised controller asks of a quadratic solver."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from hystmpc.trials.types import Vec

from .problem import QpData


@dataclass(frozen=True, eq=False)
class QpSolution:
    """What the solver found.

    Attributes:
        primal: z, shape (n,).
        usable: whether `primal` is a step worth trying: solved, or finite when the iterations ran out.
        status: the solver's own words.
        iterations: taken.
        unfinished: whether the iterations ran out.
    """

    primal: Vec
    usable: bool
    status: str
    iterations: int
    unfinished: bool = False


class QpSolver(ABC):
    """Solves the quadratic programs of one pattern; equal data give equal answers, to the last bit."""

    name: str  # in messages

    @abstractmethod
    def solve(self, data: QpData) -> QpSolution:
        """Solve one program of the family; a failure shows in the solution, not as an exception."""

"""A family of quadratic programs of one sparsity, and what solves them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hystmpc.trials.types import Vec


@dataclass(frozen=True, eq=False)
class QpPattern:
    """What never changes: sparsity and size of  min 1/2 z'Pz + q'z  s.t.  lower <= A z <= upper.

    Attributes:
        hessian: P, upper triangle in CSC order, with placeholder values.
        constraints: A in CSC order.
        moving: positions of the Jacobian's entries in the data of `constraints`; empty without soft limits.
        bounds: leading rows of A that are those of the identity: bounds on the first entries of z.
    """

    hessian: sparse.csc_matrix
    constraints: sparse.csc_matrix
    moving: NDArray[np.intp]
    bounds: int


@dataclass(frozen=True, eq=False)
class QpData:
    """What changes from step to step.

    Attributes:
        hessian_data: entries of P in the order of the pattern.
        gradient, lower, upper: q and the bounds of A z.
        constraint_data: entries of A in the order of the pattern; None while A stays as it is.
        dual: where the multipliers of A z start.
    """

    hessian_data: Vec
    gradient: Vec
    lower: Vec
    upper: Vec
    constraint_data: Vec | None
    dual: Vec


@dataclass(frozen=True, eq=False)
class QpSolution:
    """What the solver found."""

    primal: Vec  # z, shape (n,)
    usable: bool  # whether `primal` is a step worth trying: solved, or finite when the iterations ran out
    status: str  # the solver's own words
    iterations: int  # taken
    unfinished: bool = False  # whether the iterations ran out


class QpSolver(ABC):
    """Solves the quadratic programs of one pattern; equal data give equal answers, to the last bit."""

    name: str  # in messages

    @abstractmethod
    def solve(self, data: QpData) -> QpSolution:
        """Solve one program of the family; a failure shows in the solution, not as an exception."""

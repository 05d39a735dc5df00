"""DAQP: a dual active-set method, dense and exact up to rounding."""

from __future__ import annotations

import math
from dataclasses import dataclass
from threading import local
from typing import Any, final

import daqp
import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.types import Vec

from .qp import QpData, QpPattern, QpSolution, QpSolver

_STATUS = {
    1: "solved",
    -1: "primal infeasible",
    -2: "cycling",
    -3: "unbounded",
    -4: "maximum iterations reached",
    -5: "not convex",
    -6: "start overdetermined",
}
_SOLVED, _UNFINISHED = 1, -4


@dataclass(frozen=True)
class DaqpOptions:
    """Bound on the time of one solve: changes of the active set."""

    iterations: int = 1000

    def solver(self, pattern: QpPattern) -> DaqpSolver:
        """A solver of programs of this pattern."""
        return DaqpSolver(pattern, self)


@final
class DaqpSolver(QpSolver):
    """Solves every program from a cold start, so that nothing of the one before is left (Arnström et al., TAC 2022).

    The identity rows of the pattern are handed over as simple bounds. Memory for one program is kept and filled anew,
    one a thread; it is made anew after a failure.
    """

    name = "DAQP"

    def __init__(self, pattern: QpPattern, options: DaqpOptions) -> None:
        self._pattern, self._options = pattern, options
        across, down = _positions(pattern.hessian)
        size = self._size = pattern.hessian.get_shape()[0]
        self._upper, self._lower = across * size + down, down * size + across
        across, down = _positions(pattern.constraints)
        self._rows = across * size + down
        self._own = local()

    def solve(self, data: QpData) -> QpSolution:
        hessian, rows = self._filled(data)
        answer: Any = daqp.solve(
            hessian,
            data.gradient,
            rows[self._pattern.bounds :],
            data.upper,
            data.lower,
            iter_limit=self._options.iterations,
        )
        primal, _, flag, info = answer
        primal = np.array(primal, dtype=np.float64)
        finite = math.isfinite(primal.sum())
        status = _STATUS.get(flag, f"exit flag {flag}") if finite else "solution not finite"
        usable = finite and flag == _SOLVED
        if not usable:
            self._own.memory = None
        return QpSolution(primal, usable, status, int(info["iterations"]), flag == _UNFINISHED)

    def _filled(self, data: QpData) -> tuple[Vec, Vec]:
        """Hessian (n, n) and constraint rows (m, n), dense."""
        memory: tuple[Vec, Vec] | None = getattr(self._own, "memory", None)
        if memory is None:
            n, m = self._size, self._pattern.constraints.get_shape()[0]
            memory = self._own.memory = np.zeros((n, n)), np.zeros((m, n))
            memory[1].reshape(-1)[self._rows] = self._pattern.constraints.data
        hessian, rows = memory
        for half in (self._upper, self._lower):
            hessian.reshape(-1)[half] = data.hessian_data
        if data.constraint_data is not None:
            rows.reshape(-1)[self._rows] = data.constraint_data
        return hessian, rows


def _positions(matrix: Any) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of every entry of a matrix in CSC order."""
    columns = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    return np.asarray(matrix.indices, dtype=np.intp), columns.astype(np.intp)

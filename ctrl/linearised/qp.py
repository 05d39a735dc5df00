"""Quadratic programs of one sparsity pattern, and their solvers: DAQP (dual active-set) and OSQP (ADMM)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from threading import local
from typing import Any, final

import daqp
import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse

from hystmpc.trials.types import Vec


@dataclass(frozen=True, eq=False)
class QpPattern:
    """Constant part of a family of programs: sparsity and size of  min 1/2 z'Pz + q'z  s.t.  lower <= A z <= upper.

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
    """Data of one program that change between steps.

    Attributes:
        hessian_data: entries of P in the order of the pattern.
        gradient, lower, upper: q and the bounds of A z.
        constraint_data: entries of A in the order of the pattern; None while A stays as it is.
        dual: start values of the multipliers of A z.
    """

    hessian_data: Vec
    gradient: Vec
    lower: Vec
    upper: Vec
    constraint_data: Vec | None
    dual: Vec


@dataclass(frozen=True, eq=False)
class QpSolution:
    """Solution of one quadratic program."""

    primal: Vec  # z, shape (n,)
    usable: bool  # whether `primal` is a step worth trying: solved, or finite when the iterations ran out
    status: str  # message of the solver
    iterations: int
    unfinished: bool = False  # whether the iterations ran out


class QpSolver(ABC):
    """Solver of the quadratic programs of one pattern; equal data give bitwise equal solutions."""

    name: str  # name in messages

    @abstractmethod
    def solve(self, data: QpData) -> QpSolution:
        """Solve one program; a failure is reported in the solution, not as an exception."""


_DAQP_STATUS = {
    1: "solved",
    -1: "primal infeasible",
    -2: "cycling",
    -3: "unbounded",
    -4: "maximum iterations reached",
    -5: "not convex",
    -6: "start overdetermined",
}
_SOLVED, _OUT_OF_CHANGES = 1, -4


@dataclass(frozen=True)
class DaqpOptions:
    """Options of DAQP: the bound on changes of the active set limits the solution time."""

    iterations: int = 1000

    def solver(self, pattern: QpPattern) -> DaqpSolver:
        """Return a solver of programs of this pattern."""
        return DaqpSolver(pattern, self)


@final
class DaqpSolver(QpSolver):
    """Solver DAQP, cold-started: results do not depend on the order of programs (Arnström et al., TAC 2022).

    The identity rows are passed as simple bounds. Each thread reuses one workspace, which is made anew after a failure.
    """

    name = "DAQP"

    def __init__(self, pattern: QpPattern, options: DaqpOptions) -> None:
        self._pattern, self._options = pattern, options
        across, down = _positions(pattern.hessian)
        size = self._size = pattern.hessian.get_shape()[0]
        self._upper, self._lower = across * size + down, down * size + across
        across, down = _positions(pattern.constraints)
        self._rows = across * size + down
        self._per_thread = local()

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
        status = _DAQP_STATUS.get(flag, f"exit flag {flag}") if finite else "solution not finite"
        usable = finite and flag == _SOLVED
        if not usable:
            self._per_thread.memory = None
        return QpSolution(primal, usable, status, int(info["iterations"]), flag == _OUT_OF_CHANGES)

    def _filled(self, data: QpData) -> tuple[Vec, Vec]:
        memory: tuple[Vec, Vec] | None = getattr(self._per_thread, "memory", None)
        if memory is None:
            n, m = self._size, self._pattern.constraints.get_shape()[0]
            memory = self._per_thread.memory = np.zeros((n, n)), np.zeros((m, n))
            memory[1].reshape(-1)[self._rows] = self._pattern.constraints.data
        hessian, rows = memory
        for half in (self._upper, self._lower):
            hessian.reshape(-1)[half] = data.hessian_data
        if data.constraint_data is not None:
            rows.reshape(-1)[self._rows] = data.constraint_data
        return hessian, rows


def _positions(matrix: Any) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    columns = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    return np.asarray(matrix.indices, dtype=np.intp), columns.astype(np.intp)


_OSQP_UNFINISHED = "maximum iterations reached"
_USABLE = ("solved", "solved inaccurate", _OSQP_UNFINISHED)  # inaccurate: within ten times the tolerance


@dataclass(frozen=True)
class OsqpOptions:
    """Options of OSQP: tolerance and iteration bounds.

    Attributes:
        eps: absolute and relative tolerance; 1e-3 leaves errors of 1e-2 in the command.
        rhos: ADMM step sizes, tried in turn until the program is solved. A small one suits programs that touch few
            limits, a large one those that run along the rate limit; the solver's own rule adapts too slowly for
            either, and its answers would depend on the programs before.
        iterations: bound per step size; the result of the last one is used, and the status says so.
    """

    eps: float = 1e-5
    rhos: tuple[float, ...] = (0.1, 10.0, 1.0, 10.0)
    iterations: int = 60

    def solver(self, pattern: QpPattern) -> OsqpSolver:
        """Return a solver of programs of this pattern."""
        return OsqpSolver(pattern, self)


@final
class OsqpSolver(QpSolver):
    """Solver OSQP of one pattern of quadratic programs.

    Each thread reuses one workspace. Every solve starts from z = 0, the first step size and the multipliers in the
    data; the cost is scaled here, because the solver's scaling leaves rounding errors behind.
    """

    name = "OSQP"

    def __init__(self, pattern: QpPattern, options: OsqpOptions) -> None:
        self._pattern, self._options = pattern, options
        self._origin = np.zeros(pattern.hessian.get_shape()[0])
        # the last entry of every column of an upper triangle is the one on the diagonal
        self._diagonal = pattern.hessian.indptr[1:] - 1
        self._per_thread = local()
        self._per_thread.workspace = self._build()

    def solve(self, data: QpData) -> QpSolution:
        workspace = getattr(self._per_thread, "workspace", None) or self._build()
        self._per_thread.workspace = None  # a failed workspace may keep what made it fail
        scale = 1.0 / float(np.mean(data.hessian_data[self._diagonal]))
        moving = {} if data.constraint_data is None else {"Ax": data.constraint_data}
        workspace.update(Px=scale * data.hessian_data, q=scale * data.gradient, l=data.lower, u=data.upper, **moving)
        workspace.warm_start(x=self._origin, y=scale * data.dual)
        result, iterations = self._staged(workspace)
        finite = bool(np.all(np.isfinite(result.x)))
        status = str(result.info.status) if finite else "solution not finite"
        usable = finite and status in _USABLE
        if usable:
            self._per_thread.workspace = workspace
        return QpSolution(result.x, usable, status, iterations, status == _OSQP_UNFINISHED)

    def _staged(self, workspace: Any) -> tuple[Any, int]:
        """Iterate with one step size after another, each from the result of the last one."""
        first, *others = self._options.rhos
        result = _iterated(workspace, first)
        iterations = int(result.info.iter)
        for rho in others:
            if str(result.info.status) != _OSQP_UNFINISHED:
                break
            result = _iterated(workspace, rho)
            iterations += int(result.info.iter)
        return result, iterations

    def _build(self) -> Any:
        rows, variables = self._pattern.constraints.get_shape()
        workspace = osqp.OSQP()
        # copies: an update writes into the matrices of the set-up, and one that is not finite would stay in the pattern
        workspace.setup(
            P=self._pattern.hessian.copy(),
            q=np.zeros(variables),
            A=self._pattern.constraints.copy(),
            l=np.full(rows, -1.0),
            u=np.full(rows, 1.0),
            eps_abs=self._options.eps,
            eps_rel=self._options.eps,
            max_iter=self._options.iterations,
            rho=self._options.rhos[0],
            adaptive_rho=0,
            scaling=0,
            polishing=False,
            warm_starting=True,
            check_termination=5,
            verbose=False,
        )
        return workspace


def _iterated(workspace: Any, rho: float) -> Any:
    workspace.update_settings(rho=rho)
    return workspace.solve(raise_error=False)

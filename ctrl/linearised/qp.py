"""Quadratic programs of one sparsity pattern, and their solution by OSQP (ADMM); that of the engine is core/qp.c."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from threading import Lock, local
from typing import Any, final

import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse

from hystmpc.trials.types import Mat, Vec


@dataclass(frozen=True, eq=False)
class QpPattern:
    """Constant part of a family of programs.

        min 1/2 z'Pz + q'z + sum_r s_r^2 / (2 c_r)  s.t.  lower <= A z + s <= upper

    Attributes:
        nonzero: where A may differ from zero, column by column (n, R).
        soft: rows (R,) that have a variable s; it is zero in the others.
    """

    nonzero: NDArray[np.bool_]
    soft: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class QpData:
    """Data of one program.

    Attributes:
        hessian: P (n, n), of which the lower triangle is used.
        gradient: q (n,).
        columns: A, column by column (n, R).
        lower, upper: bounds (R,) of A z + s.
        soft: c (R,), zero in rows without s.
        dual: start values (R,) of the multipliers of A z + s, for iterative solvers.
    """

    hessian: Mat
    gradient: Vec
    columns: Mat
    lower: Vec
    upper: Vec
    soft: Vec
    dual: Vec


@dataclass(frozen=True, eq=False)
class QpSolution:
    """Solution of one quadratic program."""

    primal: Vec  # z, shape (n,)
    usable: bool  # whether `primal` is a step worth trying: solved, or finite when the iterations ran out
    status: str  # message of the solver
    iterations: int
    unfinished: bool = False  # whether the iterations ran out


_OSQP_UNFINISHED, _OSQP_INTERRUPTED = "maximum iterations reached", "interrupted"
_ALONE = Lock()  # OSQP takes Ctrl-C while it solves; of two at a time the later one would give back the other's handler
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
class OsqpSolver:
    """Solver OSQP of one pattern of quadratic programs; equal data give bitwise equal solutions.

    Each thread reuses one workspace. Every solve starts from z = 0, the first step size and the multipliers in the
    data; the cost is scaled here, because the solver's scaling leaves rounding errors behind.
    """

    def __init__(self, pattern: QpPattern, options: OsqpOptions) -> None:
        self._pattern, self._options = pattern, options
        self._unknowns = len(pattern.nonzero)
        self._lower = np.tril_indices(self._unknowns)  # row by row, which is the upper triangle column by column
        self._slacks = np.ones(int(pattern.soft.sum()))
        self._origin = np.zeros(self._unknowns + self._slacks.size)
        self._per_thread = local()
        self._per_thread.workspace = self._build()

    def solve(self, data: QpData) -> QpSolution:
        """Solve one program; what OSQP answers without a solution stands in the answer."""
        workspace = getattr(self._per_thread, "workspace", None) or self._build()
        self._per_thread.workspace = None  # a failed workspace may keep what made it fail
        slacks = 1.0 / data.soft[self._pattern.soft]
        scale = self._origin.size / float(np.trace(data.hessian) + slacks.sum())
        workspace.update(
            Px=scale * np.concatenate([data.hessian[self._lower], slacks]),
            q=scale * np.concatenate([data.gradient, 0.0 * slacks]),
            Ax=np.concatenate([data.columns[self._pattern.nonzero], self._slacks]),
            l=data.lower,
            u=data.upper,
        )
        workspace.warm_start(x=self._origin, y=scale * data.dual)
        result, iterations = self._staged(workspace)
        finite = bool(np.all(np.isfinite(result.x)))
        status = str(result.info.status) if finite else "solution not finite"
        usable = finite and status in _USABLE
        if usable:
            self._per_thread.workspace = workspace
        return QpSolution(result.x[: self._unknowns], usable, status, iterations, status == _OSQP_UNFINISHED)

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
        size, rows = self._pattern.nonzero.shape
        hessian = [np.triu(np.ones((size, size))), sparse.eye(self._slacks.size)]
        slacks = sparse.csc_array(sparse.eye(rows))[:, self._pattern.soft]
        workspace = osqp.OSQP()
        workspace.setup(
            P=sparse.csc_matrix(sparse.block_diag(hessian, format="csc")),
            q=self._origin,
            A=sparse.csc_matrix(
                sparse.hstack([sparse.csc_matrix(1.0 * self._pattern.nonzero.T), slacks], format="csc")
            ),
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
    with _ALONE:
        result = workspace.solve(raise_error=False)
    if str(result.info.status) == _OSQP_INTERRUPTED:
        signal.raise_signal(signal.SIGINT)  # for the handler of this process
    return result

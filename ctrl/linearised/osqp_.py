"""OSQP: one workspace with fixed sparsity, updated, warm-started and rebuilt after a failure."""

from __future__ import annotations

from dataclasses import dataclass
from threading import local
from typing import Any, final

import numpy as np
import osqp

from .qp import QpData, QpPattern, QpSolution, QpSolver

_UNFINISHED = "maximum iterations reached"
_USABLE = ("solved", "solved inaccurate", _UNFINISHED)  # inaccurate: within ten times the tolerance


@dataclass(frozen=True)
class OsqpOptions:
    """Tolerance, and the bound on the time of one solve.

    Attributes:
        eps: absolute and relative tolerance; 1e-3 leaves errors of 1e-2 in the command.
        rhos: ADMM step sizes, tried in turn until the program is solved. A small one suits programs that touch few
            limits, a large one those that run along the rate limit; the solver's own rule adapts too slowly for
            either, and its answers would depend on the programs before.
        iterations: bound per step size; what is reached by the last is used, and said in the status.
    """

    eps: float = 1e-5
    rhos: tuple[float, ...] = (0.1, 10.0, 1.0, 10.0)
    iterations: int = 60

    def solver(self, pattern: QpPattern) -> OsqpSolver:
        """A solver of programs of this pattern."""
        return OsqpSolver(pattern, self)


@final
class OsqpSolver(QpSolver):
    """Solves one family of quadratic programs.

    The workspace, one a thread, only saves time: every solve starts from z = 0, the first step size and the
    multipliers that come with the data, and the cost is scaled here and not by the solver, whose scaling leaves
    rounding errors behind.
    So equal data give equal answers, to the last bit.
    """

    name = "OSQP"

    def __init__(self, pattern: QpPattern, options: OsqpOptions) -> None:
        self._pattern, self._options = pattern, options
        self._origin = np.zeros(pattern.hessian.get_shape()[0])
        # the last entry of every column of an upper triangle is the one on the diagonal
        self._diagonal = pattern.hessian.indptr[1:] - 1
        self._own = local()
        self._own.workspace = self._build()

    def solve(self, data: QpData) -> QpSolution:
        workspace = getattr(self._own, "workspace", None) or self._build()
        self._own.workspace = None  # a failed workspace may keep what made it fail
        scale = 1.0 / float(np.mean(data.hessian_data[self._diagonal]))
        moving = {} if data.constraint_data is None else {"Ax": data.constraint_data}
        workspace.update(Px=scale * data.hessian_data, q=scale * data.gradient, l=data.lower, u=data.upper, **moving)
        workspace.warm_start(x=self._origin, y=scale * data.dual)
        result, iterations = self._staged(workspace)
        finite = bool(np.all(np.isfinite(result.x)))
        status = str(result.info.status) if finite else "solution not finite"
        usable = finite and status in _USABLE
        if usable:
            self._own.workspace = workspace
        return QpSolution(result.x, usable, status, iterations, status == _UNFINISHED)

    def _staged(self, workspace: Any) -> tuple[Any, int]:
        """Iterate with one step size after the other, each from where the last one stopped."""
        first, *others = self._options.rhos
        result = _iterated(workspace, first)
        iterations = int(result.info.iter)
        for rho in others:
            if str(result.info.status) != _UNFINISHED:
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

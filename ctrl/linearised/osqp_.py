"""OSQP: one workspace with fixed sparsity, updated, warm-started and rebuilt after a failure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
import osqp
from numpy.typing import NDArray

from .problem import QpData, QpPattern

Vec = NDArray[np.float64]


@dataclass(frozen=True)
class OsqpOptions:
    """Tolerances and bounds of the solver; the step size is fixed, so that equal data give equal answers.

    Attributes:
        eps: absolute and relative tolerance; 1e-3 leaves errors of 1e-2 in the command.
        max_iterations: bound on the time of one solve; what is reached by then is used, and said in the status.
        rho: ADMM step size after scaling.
    """

    eps: float = 1e-5
    max_iterations: int = 250
    rho: float = 0.1


@dataclass(frozen=True, eq=False)
class QpSolution:
    """What the solver found.

    Attributes:
        primal: z, shape (n,).
        usable: whether `primal` is a step worth trying: solved, or finite when the iterations ran out.
        status: `solved`, or the solver's own words.
        iterations: taken.
    """

    primal: Vec
    usable: bool
    status: str
    iterations: int


_USABLE = ("solved", "solved inaccurate", "maximum iterations reached")


@final
class OsqpSolver:
    """Solves one family of quadratic programs.

    The workspace only saves time: every solve starts from z = 0 and the multipliers that come with the data, so a
    solution depends on nothing but the arguments.
    """

    def __init__(self, pattern: QpPattern, options: OsqpOptions) -> None:
        self._pattern, self._options = pattern, options
        self._origin = np.zeros(pattern.hessian.shape[0])
        self._workspace: Any = self._build()

    def solve(self, data: QpData) -> QpSolution:
        """Solve one program of the family; a failure shows in the solution, not as an exception."""
        if self._workspace is None:
            self._workspace = self._build()
        workspace = self._workspace
        moving = {} if data.constraint_data is None else {"Ax": data.constraint_data}
        workspace.update(Px=data.hessian_data, q=data.gradient, l=data.lower, u=data.upper, **moving)
        workspace.warm_start(x=self._origin, y=data.dual)
        result = workspace.solve(raise_error=False)
        finite = bool(np.all(np.isfinite(result.x)))
        status = str(result.info.status) if finite else "solution not finite"
        usable = finite and status in _USABLE
        if not usable:
            self._workspace = None  # a failed workspace may keep what made it fail
        return QpSolution(result.x, usable, status, int(result.info.iter))

    def _build(self) -> Any:
        variables, rows = self._pattern.hessian.shape[0], self._pattern.constraints.shape[0]
        workspace = osqp.OSQP()
        workspace.setup(
            P=self._pattern.hessian + 0.0,
            q=np.zeros(variables),
            A=self._pattern.constraints,
            l=np.full(rows, -1.0),
            u=np.full(rows, 1.0),
            eps_abs=self._options.eps,
            eps_rel=self._options.eps,
            max_iter=self._options.max_iterations,
            rho=self._options.rho,
            adaptive_rho=0,
            polishing=False,
            warm_starting=True,
            check_termination=5,
            verbose=False,
        )
        return workspace

"""The condensed quadratic program of the linearised controller, built apart from any solver."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hystmpc.trials.types import Mat, Vec

from ..limits import CommandLimits
from ..plan_kernels import condense, rate_multipliers
from ..planning import Plan, PlanningProblem, Weights


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

    @property
    def variables(self) -> int:
        """Entries of z."""
        return self.hessian.get_shape()[0]

    @property
    def rows(self) -> int:
        """Rows of A."""
        return self.constraints.get_shape()[0]


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


class PlanProgram(ABC):
    """The quadratic program around a plan, and what its answer means."""

    pattern: QpPattern

    @abstractmethod
    def data(self, problem: PlanningProblem, around: Plan, jacobian: Mat) -> QpData:
        """The program around the plan `around` with Jacobian (H, H), lower triangular [deg per command unit]."""

    @abstractmethod
    def deviation(self, primal: Vec) -> Vec:
        """What z = `primal` adds to the commands of the plan (H,)."""


@final
class TrackingQp(PlanProgram):
    """The planning cost with linearised angles, in the deviation v of the commands from a plan p.

        theta(p + v) ~ theta_p + J v
        P = 2 (J'QJ + w_r D'D + w_e I),  q = 2 (J'Q (theta_p - r) + w_r D'(D p - e_1 u_last) + w_e (p - f))
        lower <= p + v <= upper,  -rate dt <= D (p + v) - e_1 u_last <= rate dt

    with D the difference matrix. Soft angle limits add H free variables s with cost w_s s^2 and the rows
    a <= theta_p + J v + s <= b, which is the squared distance to [a, b] exactly.

    Multipliers start where they hold the plan that already moves at the greatest rate: stationarity D'y = -q, solved
    backwards in time, of the right sign, and zero where the rate limit is not touched. First-order methods take
    thousands of iterations to find these, and the best candidates of a reversal touch the limit over many samples.
    """

    def __init__(self, weights: Weights, limits: CommandLimits, horizon: int, dt: float) -> None:
        self._weights, self._limits, self._horizon = weights, limits, horizon
        self._reach = limits.rate * dt
        self._tracking = weights.over(horizon)
        self._factors = np.array((weights.rate, weights.effort))
        # the Jacobian is lower triangular; column by column its entries are those of the transpose, row by row
        self._columns = np.triu_indices(horizon)
        self.pattern = self._build_pattern()

    def data(self, problem: PlanningProblem, around: Plan, jacobian: Mat) -> QpData:
        plan = around.commands
        moves = moves_of(plan, problem.u_last)
        error, off = around.angles - problem.reference, plan - problem.feedforward
        hessian = np.empty(plan.size * (plan.size + 1) // 2)
        gradient = condense(jacobian, error, self._tracking, moves, off, self._factors, hessian)
        none = np.zeros(plan.size)
        hard = QpData(
            hessian,
            gradient,
            np.concatenate([self._limits.lower - plan, -self._reach - moves]),
            np.concatenate([self._limits.upper - plan, self._reach - moves]),
            None,
            np.concatenate([none, rate_multipliers(gradient, moves, self._reach)]),
        )
        return self._softened(hard, problem, around, jacobian) if self._weights.limits_angle else hard

    def deviation(self, primal: Vec) -> Vec:
        return primal[: self._horizon]

    def _softened(self, hard: QpData, problem: PlanningProblem, around: Plan, jacobian: Mat) -> QpData:
        """The program with soft angle limits beside the hard limits."""
        low, high = problem.angle_limits
        none = np.zeros(self._horizon)
        constraint_data = np.array(self.pattern.constraints.data, dtype=np.float64)
        constraint_data[self.pattern.moving] = jacobian.T[self._columns]
        return QpData(
            np.concatenate([hard.hessian_data, none + 2.0 * self._weights.soft_limit]),
            np.concatenate([hard.gradient, none]),
            np.concatenate([hard.lower, low - around.angles]),
            np.concatenate([hard.upper, high - around.angles]),
            constraint_data,
            np.concatenate([hard.dual, none]),
        )

    def _build_pattern(self) -> QpPattern:
        horizon = self._horizon
        hessian = sparse.csc_matrix(np.triu(np.ones((horizon, horizon))))
        difference = np.eye(horizon) - np.eye(horizon, k=-1)
        rows = [sparse.eye(horizon), sparse.csc_matrix(difference)]
        if not self._weights.limits_angle:
            return QpPattern(
                hessian, sparse.csc_matrix(sparse.vstack(rows, format="csc")), np.empty(0, dtype=np.intp), horizon
            )
        marker = 2.0  # told apart from the ones of the other blocks
        triangle = sparse.csc_matrix(marker * np.tril(np.ones((horizon, horizon))))
        blocks = [[rows[0], None], [rows[1], None], [triangle, sparse.eye(horizon)]]
        constraints = sparse.csc_matrix(sparse.bmat(blocks, format="csc"))
        hessian = sparse.csc_matrix(sparse.block_diag([hessian, sparse.eye(horizon)], format="csc"))
        return QpPattern(hessian, constraints, np.flatnonzero(constraints.data == marker), horizon)


def moves_of(plan: Vec, u_last: float) -> Vec:
    """D p - e_1 u_last (H,); `np.diff` with a prefix takes ten times as long."""
    moves = plan.copy()
    moves[0] -= u_last
    moves[1:] -= plan[:-1]
    return moves

"""The condensed quadratic program with blocked moves: a few variables whatever the horizon."""

from __future__ import annotations

from typing import final

import numpy as np
from scipy import sparse

from hystmpc.trials.types import Mat, Vec

from ..limits import CommandLimits
from ..plan_kernels import block_columns, block_room, condense_blocked, rate_multipliers
from ..planning import Plan, PlanningProblem, Weights
from .blocking import MoveBlocking
from .problem import PlanProgram, QpData, QpPattern, moves_of


@final
class BlockedQp(PlanProgram):
    """`TrackingQp` in the deviations w (m,) at the ends of blocks, v = M w; see `MoveBlocking`.

        P = 2 ((J M)'Q (J M) + w_r (D M)'D M + w_e M'M),  q = M' q_full
        lower <= p + M w <= upper in every sample
        L_b (-rate dt - min D p) <= w_b - w_{b-1} <= L_b (rate dt - max D p),  min and max over block b

    It is the same program under the equality v = M w: the move of v is one number a block, so the rate of all its
    samples is one row, and what is left of the box are the rows of M. Soft angle limits add H slacks as there.
    """

    def __init__(self, weights: Weights, limits: CommandLimits, blocking: MoveBlocking, dt: float) -> None:
        self._weights, self._limits, self._reach = weights, limits, limits.rate * dt
        self._matrix, self._starts, self._ends = blocking.matrix, blocking.starts, blocking.ends
        horizon = blocking.horizon
        self._between = np.setdiff1d(np.arange(horizon), self._ends)
        self._doubled = 2.0 * weights.over(horizon)
        difference = np.eye(horizon) - np.eye(horizon, k=-1)
        self._by_move = 2.0 * weights.rate * (difference @ self._matrix)
        self._by_command = 2.0 * weights.effort * self._matrix
        self._constant = (difference @ self._matrix).T @ self._by_move + self._matrix.T @ self._by_command
        self.pattern = self._build_pattern()

    def data(self, problem: PlanningProblem, around: Plan, jacobian: Mat) -> QpData:
        plan, count = around.commands, self._starts.size
        moves, off = moves_of(plan, problem.u_last), plan - problem.feedforward
        columns = np.empty(self._matrix.shape)
        block_columns(jacobian, self._matrix, self._starts, columns)
        weighted = np.stack((self._doubled, self._doubled * (around.angles - problem.reference)))
        gradient, hessian = moves @ self._by_move + off @ self._by_command, np.empty(count * (count + 1) // 2)
        condense_blocked(columns, self._starts, weighted, self._constant, gradient, hessian)
        low, high, extreme = np.empty((3, count))
        block_room(moves, self._starts, self._ends, self._reach, low, high, extreme)
        down, up = self._limits.lower - plan, self._limits.upper - plan
        hard = QpData(
            hessian,
            gradient,
            np.concatenate([down[self._ends], low, down[self._between]]),
            np.concatenate([up[self._ends], high, up[self._between]]),
            None,
            np.concatenate(
                [np.zeros(count), rate_multipliers(gradient, extreme, self._reach), np.zeros(self._between.size)]
            ),
        )
        return self._softened(hard, problem, around, columns) if self._weights.limits_angle else hard

    def deviation(self, primal: Vec) -> Vec:
        deviation: Vec = self._matrix @ primal[: self._starts.size]
        return deviation

    def _softened(self, hard: QpData, problem: PlanningProblem, around: Plan, columns: Mat) -> QpData:
        """The program with soft angle limits beside the hard limits."""
        low, high = problem.angle_limits
        none = np.zeros(around.angles.size)
        constraint_data = np.array(self.pattern.constraints.data, dtype=np.float64)
        constraint_data[self.pattern.moving] = columns.T.ravel()
        return QpData(
            np.concatenate([hard.hessian_data, none + 2.0 * self._weights.soft_limit]),
            np.concatenate([hard.gradient, none]),
            np.concatenate([hard.lower, low - around.angles]),
            np.concatenate([hard.upper, high - around.angles]),
            constraint_data,
            np.concatenate([hard.dual, none]),
        )

    def _build_pattern(self) -> QpPattern:
        horizon, count = self._matrix.shape
        hessian = sparse.csc_matrix(np.triu(np.ones((count, count))))
        rows = np.vstack([np.eye(count), np.eye(count) - np.eye(count, k=-1), self._matrix[self._between]])
        if not self._weights.limits_angle:
            return QpPattern(hessian, sparse.csc_matrix(rows), np.empty(0, dtype=np.intp), count)
        marker = 2.0  # told apart from the other blocks, whose entries are at most one
        angles = np.full((horizon, count), marker)
        blocks = [[sparse.csc_matrix(rows), None], [sparse.csc_matrix(angles), sparse.eye(horizon)]]
        constraints = sparse.csc_matrix(sparse.bmat(blocks, format="csc"))
        hessian = sparse.csc_matrix(sparse.block_diag([hessian, sparse.eye(horizon)], format="csc"))
        return QpPattern(hessian, constraints, np.flatnonzero(constraints.data == marker), count)

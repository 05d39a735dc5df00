"""Quadratic program of a planning step, and its solution by OSQP as the engine calls it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from threading import local
from typing import final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.core.outside import keep_fault, numbers_at
from hystmpc.core.structs import Struct, constants, struct
from hystmpc.trials.types import Mat, Vec

from ..command import CommandLimits
from ..law_tables import MoveBlocking, law_over
from ..mpc_settings import WeightsSettings
from .qp import OsqpOptions, QpData, QpPattern


@dataclass(frozen=True, eq=False)
class PlanningTask:
    """What is planned for; every angle in it is the model's, without the output disturbance."""

    u_last: float  # the command really sent last
    reference: Vec  # wanted angles [deg], shape (H,)
    feedforward: Vec  # the inverse plan, from which effort is measured, shape (H,)
    angle_limits: tuple[float, float]  # soft limits of the angle [deg], lower and upper

    @cached_property
    def part(self) -> Struct:
        """Struct `hystmpc_task` of core/law.h."""
        low, high = self.angle_limits
        return struct(
            "hystmpc_task",
            reference=self.reference,
            feedforward=self.feedforward,
            u_last=self.u_last,
            low=low,
            high=high,
        )


@final
class PlanProgram:
    """Quadratic program of the planning cost with linearised angles, in the deviation v of the commands from a plan p.

        theta(p + v) ~ theta_p + J v
        P = 2 (J'QJ + w_r D'D + w_e I),  q = 2 (J'Q (theta_p - r) + w_r D'(D p - e_1 u_last) + w_e (p - f))
        lower <= p + v <= upper,  -rate dt <= D (p + v) - e_1 u_last <= rate dt

    with D the difference matrix. Soft angle limits add H free variables s with cost w_s s^2 and the rows
    a <= theta_p + J v + s <= b, which is the squared distance to [a, b] exactly.

    With blocks of moves the unknowns are the deviations w (m,) at their ends, v = M w, and the rate of all samples of
    block b, in which the move of v is constant, is one row:

        P = 2 ((J M)'Q (J M) + w_r (D M)'D M + w_e M'M),  q = M' q_full
        L_b (-rate dt - min D p) <= w_b - w_{b-1} <= L_b (rate dt - max D p),  min and max over block b

    Rows stand in the order of the samples; the engine fills them, see core/law.c.

    Args:
        dt: sample time [s].
        blocks: samples of each block of moves; None if every sample may move.

    Attributes:
        pattern: of all programs of these settings.

    Raises:
        ControllerError: if the angle limits cross, or the blocks do not fit the horizon.
    """

    def __init__(
        self,
        weights: WeightsSettings,
        limits: CommandLimits,
        horizon: int,
        dt: float,
        blocks: tuple[int, ...] | None = None,
    ) -> None:
        blocking = MoveBlocking(blocks or (1,) * horizon, horizon)
        self._law = law_over(weights, horizon, limits, dt, blocks)
        self._matrix = None if blocks is None else blocking.matrix
        self._horizon, self._count, soft = horizon, len(blocking.lengths), weights.limits_angle
        # of each sample the command, then the angle; a move before the first command of its block, or else behind it
        self._moves = blocking.starts * (1 + soft) + np.arange(self._count) + (blocks is None)
        self._touching = 1e-6 * limits.rate * dt * np.array(blocking.lengths)
        self._rows = horizon + self._count + (horizon if soft else 0)
        rest = np.zeros(horizon)
        task = PlanningTask(0.0, rest, rest, (0.0, 0.0))
        free = self.data(task, rest, rest, np.tril(np.ones((horizon, horizon))))
        self.pattern = QpPattern(free.columns != 0.0, free.soft > 0.0)

    def data(self, task: PlanningTask, commands: Vec, angles: Vec, jacobian: Mat) -> QpData:
        """Return the program around a plan.

        Args:
            commands, angles: of the plan (H,).
            jacobian: of the angles (H, H), lower triangular [deg per command unit].
        """
        count, rows = self._count, self._rows
        hessian, gradient, by_column, bounds = (np.empty(s) for s in ((count, count), count, (count, rows), (3, rows)))
        known = self._law.address, task.part.address, np.ascontiguousarray(jacobian), commands, angles, self._room()
        engine().program(*known, hessian, gradient, by_column, bounds)
        lower, upper, soft = bounds
        return QpData(hessian, gradient, by_column, lower, upper, soft, self._multipliers(gradient, lower, upper))

    def deviation(self, primal: Vec) -> Vec:
        """Return the deviation of the commands from the plan (H,) in a solution z = `primal` (m,)."""
        return primal if self._matrix is None else self._matrix @ primal

    def after(self, task: PlanningTask, commands: Vec, angles: Vec, jacobian: Mat, primal: Vec) -> Vec:
        """Return the admissible plan after the solution z = `primal`, with its foreseen cost (H + 1,)."""
        out = np.empty(self._horizon + 1)
        known = self._law.address, task.part.address, np.ascontiguousarray(jacobian), commands, angles
        engine().plan_after(*known, np.ascontiguousarray(primal), self._room(), out)
        return out

    def _room(self) -> Vec:
        return np.empty(engine().law_bytes(self._law.address), dtype=np.uint8)

    def _multipliers(self, gradient: Vec, lower: Vec, upper: Vec) -> Vec:
        """Multipliers (R,) that hold a plan at the greatest rate where it already has it.

        Stationarity D'y = -q, solved backwards in time, of the right sign, and zero where the rate limit is not
        touched. First-order methods take thousands of iterations to find these, and the best candidates of a reversal
        touch the limit over many samples.
        """
        dual, balance = np.zeros(lower.size), -np.cumsum(gradient[::-1])[::-1]
        fast, slow = upper[self._moves] <= self._touching, lower[self._moves] >= -self._touching
        held = np.where(fast, np.maximum(balance, 0.0), np.where(slow, np.minimum(balance, 0.0), 0.0))
        dual[self._moves] = held
        return dual


@final
class IterativeSolution:
    """Solution of a planning step's program by OSQP, as the engine calls it: `solve` of core/planner.h.

    Args:
        blocks: samples of each block of moves; None if every sample may move.
    """

    def __init__(
        self,
        weights: WeightsSettings,
        limits: CommandLimits,
        horizon: int,
        dt: float,
        blocks: tuple[int, ...] | None,
        options: OsqpOptions,
    ) -> None:
        self._program = PlanProgram(weights, limits, horizon, dt, blocks)
        self._solver = options.solver(self._program.pattern)
        self._horizon, self._local = horizon, local()

    @property
    def words(self) -> str:
        """Words of this thread's last solution."""
        return str(getattr(self._local, "words", ""))

    def __call__(
        self, reference: int, feedforward: int, scalars: int, jacobian: int, commands: int, angles: int, out: int
    ) -> int:
        """Solve the program around a plan; 0, 1 where the iterations ran out, or a negative number for no solution."""
        size = self._horizon
        u_last, low, high = numbers_at(scalars, 3).tolist()
        wanted, feed, plan, along = (numbers_at(at, size) for at in (reference, feedforward, commands, angles))
        slopes = numbers_at(jacobian, size, size)
        try:
            task = PlanningTask(u_last, wanted, feed, (low, high))
            data = self._program.data(task, plan, along, slopes)
            if not np.isfinite(data.hessian.sum() + data.gradient.sum()):
                return _NO_PROGRAM if np.isfinite(slopes.sum()) else _NO_JACOBIAN
            solution = self._solver.solve(data)
        except BaseException as error:  # noqa: BLE001 - through C no exception passes
            keep_fault(error)
            return _NO_ANSWER
        self._local.words = f"OSQP: {solution.status}"
        if not solution.usable:
            return _NOT_FINITE
        numbers_at(out, size + 1)[:] = self._program.after(task, plan, along, slopes, solution.primal)
        return int(solution.unfinished)


_NO_JACOBIAN, _NO_PROGRAM, _NO_ANSWER, _NOT_FINITE = (
    constants()[f"HYSTMPC_{name}"] for name in ("NO_JACOBIAN", "NO_PROGRAM", "NO_ANSWER", "QP_NOT_FINITE")
)

"""Quadratic program of a planning step, its cost, and its solution by OSQP as the engine calls it."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, fields
from functools import cached_property
from threading import local
from typing import Any, final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.core.outside import keep_fault
from hystmpc.core.structs import constants
from hystmpc.trials.types import Mat, Vec

from ..command import CommandLimits, CommandPlan
from ..law_tables import LawTables, MoveBlocking
from ..mpc_settings import WeightsSettings
from .qp import OsqpOptions, QpData, QpPattern


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """Planning problem; every angle in it is the model's, without the output disturbance."""

    state: Vec  # predictor state (S,) at which the plan starts to act
    u_last: float  # the command really sent last
    reference: Vec  # wanted angles [deg], shape (H,)
    feedforward: Vec  # the inverse plan, from which effort is measured, shape (H,)
    angle_limits: tuple[float, float]  # soft limits of the angle [deg], lower and upper

    @cached_property
    def task(self) -> int:
        """Address of the numbers of the problem as the engine takes them: see core/planning.h."""
        horizon = self.reference.size
        numbers: Any = np.empty(3 + 2 * horizon)
        numbers[0] = self.u_last
        numbers[1], numbers[2] = self.angle_limits
        numbers[3 : 3 + horizon] = self.reference
        numbers[3 + horizon :] = self.feedforward
        known = ctypes.c_char.from_buffer(numbers)  # keeps the numbers
        self.__dict__["_numbers"] = known  # as long as the address is used
        return ctypes.addressof(known)

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # a copy has numbers of its own


@final
class PlanCost:
    """Planning cost, which ranks candidates, steps of the line search and samples.

        J(u) = sum_k q_k (theta_k - r_k)^2 + w_s dist(theta_k, [a, b])^2 + w_r (u_k - u_{k-1})^2 + w_e (u_k - f_k)^2

    with u_{-1} the command really sent last, [a, b] the soft angle limits and f the inverse plan.
    """

    def __init__(self, weights: WeightsSettings, horizon: int) -> None:
        self._tables = LawTables(weights, horizon)
        self._costs, self._cheapest = engine().costs, engine().cheapest

    def __call__(self, plans: Vec, angles: Vec, problem: PlanningProblem) -> Vec:
        """Compute the costs (N,) of the plans (N, H) with angles (N, H); infinite where a prediction is not finite."""
        values = np.empty(len(plans))
        rows = np.ascontiguousarray(plans), np.ascontiguousarray(angles)
        self._costs(self._tables.address, problem.task, len(plans), *rows, values)
        return values

    def best(self, plans: Vec, angles: Vec, problem: PlanningProblem) -> CommandPlan:
        """Return the first of the cheapest plans; its cost is infinite if no prediction is finite."""
        cost = np.empty(1)
        angles = np.ascontiguousarray(angles)
        row = self._cheapest(self._tables.address, problem.task, len(plans), plans, angles, cost)
        return CommandPlan(plans[row], angles[row], float(cost[0]))


class PlanProgram:
    """Quadratic program around a plan, its solution by the engine, and the plan after the solution.

    The move of each block of samples, or of each sample, is one unknown; rows stand in the order of the samples.

    Args:
        blocking: of the moves; None if every sample may move.

    Raises:
        ControllerError: if the angle limits cross.
    """

    def __init__(
        self,
        weights: WeightsSettings,
        limits: CommandLimits,
        horizon: int,
        dt: float,
        blocking: MoveBlocking | None = None,
    ) -> None:
        self.tables = tables = LawTables(weights, horizon, limits, dt, blocking)
        self._matrix = None if blocking is None else blocking.matrix
        starts = np.arange(horizon) if blocking is None else blocking.starts
        lengths = np.ones(horizon) if blocking is None else np.array(blocking.lengths)
        # of each sample the command, then the angle; a move before the first command of its block, or else behind it
        self._moves = starts * (1 + tables.soft) + np.arange(tables.moves) + (blocking is None)
        self._touching = 1e-6 * tables.bounds.reach * lengths
        self._step, self._after, self._program = engine().plan_step, engine().plan_after, engine().program
        rest, columns = np.zeros(horizon), self._columns(np.tril(np.ones((horizon, horizon))))
        free = self._around(PlanningProblem(rest, 0.0, rest, rest, (0.0, 0.0)), rest, rest, columns)
        self.pattern = QpPattern(free.columns != 0.0, free.soft > 0.0)

    def data(self, problem: PlanningProblem, around: CommandPlan, jacobian: Mat) -> QpData:
        """Return the program around the plan `around` with Jacobian (H, H), lower triangular [deg per command unit]."""
        return self._around(problem, around.commands, around.angles, self._columns(np.ascontiguousarray(jacobian)))

    def deviation(self, primal: Vec) -> Vec:
        """Return the deviation of the commands from the plan (H,) in a solution z = `primal` (m,)."""
        return primal if self._matrix is None else self._matrix @ primal

    def solved(self, problem: PlanningProblem, around: CommandPlan, jacobian: Mat, changes: int) -> tuple[int, Vec]:
        """Return changes of the active set, and the admissible plan after the solution with its foreseen cost (H + 1,).

        Negative numbers of changes say why there is no solution, see core/planning.h.
        """
        out, tables = np.empty(self.tables.horizon + 1), self.tables
        known = tables.address, problem.task, jacobian, around.commands, around.angles
        return self._step(*known, changes, tables.room, out), out

    def after(self, problem: PlanningProblem, around: CommandPlan, jacobian: Mat, primal: Vec) -> Vec:
        """Return the admissible plan after the solution z = `primal`, with its foreseen cost (H + 1,)."""
        out, tables = np.empty(self.tables.horizon + 1), self.tables
        known = tables.address, problem.task, jacobian, around.commands, around.angles
        self._after(*known, np.ascontiguousarray(primal), tables.room, out)
        return out

    def _columns(self, jacobian: Mat) -> Mat:
        if self._matrix is None:
            return jacobian
        columns = np.empty(self._matrix.shape)
        engine().blocked_jacobian(self.tables.address, jacobian, columns)
        return columns

    def _around(self, problem: PlanningProblem, commands: Vec, angles: Vec, columns: Mat) -> QpData:
        tables, count = self.tables, self.tables.moves
        rows = tables.horizon + count + (tables.horizon if tables.soft else 0)
        hessian, gradient, by_column, bounds = (np.empty(s) for s in ((count, count), count, (count, rows), (3, rows)))
        known = tables.address, problem.task, columns, commands, angles, tables.room
        self._program(*known, hessian, gradient, by_column, bounds)
        lower, upper, soft = bounds
        return QpData(hessian, gradient, by_column, lower, upper, soft, self._multipliers(gradient, lower, upper))

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
class TrackingQp(PlanProgram):
    """Quadratic program of the planning cost with linearised angles, in the deviation v of the commands from a plan p.

        theta(p + v) ~ theta_p + J v
        P = 2 (J'QJ + w_r D'D + w_e I),  q = 2 (J'Q (theta_p - r) + w_r D'(D p - e_1 u_last) + w_e (p - f))
        lower <= p + v <= upper,  -rate dt <= D (p + v) - e_1 u_last <= rate dt

    with D the difference matrix. Soft angle limits add H free variables s with cost w_s s^2 and the rows
    a <= theta_p + J v + s <= b, which is the squared distance to [a, b] exactly.
    """

    def __init__(self, weights: WeightsSettings, limits: CommandLimits, horizon: int, dt: float) -> None:
        super().__init__(weights, limits, horizon, dt)


@final
class BlockedQp(PlanProgram):
    """Quadratic program `TrackingQp` with move blocking: deviations w (m,) at the ends of blocks, v = M w.

        P = 2 ((J M)'Q (J M) + w_r (D M)'D M + w_e M'M),  q = M' q_full
        lower <= p + M w <= upper in every sample
        L_b (-rate dt - min D p) <= w_b - w_{b-1} <= L_b (rate dt - max D p),  min and max over block b

    The move of v is constant in a block, so the rate of all its samples is one row. Soft angle limits add H slacks.
    """

    def __init__(self, weights: WeightsSettings, limits: CommandLimits, blocking: MoveBlocking, dt: float) -> None:
        super().__init__(weights, limits, blocking.horizon, dt, blocking)


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
        blocking = None if blocks is None else MoveBlocking(blocks, horizon)
        self._program = PlanProgram(weights, limits, horizon, dt, blocking)
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
        u_last, low, high = _numbers(scalars, 3).tolist()
        wanted, feed, plan, along = (_numbers(at, size) for at in (reference, feedforward, commands, angles))
        problem, around = PlanningProblem(plan, u_last, wanted, feed, (low, high)), CommandPlan(plan, along, 0.0)
        slopes = _numbers(jacobian, size * size).reshape(size, size)
        try:
            data = self._program.data(problem, around, slopes)
            if not np.isfinite(data.hessian.sum() + data.gradient.sum()):
                return _NO_PROGRAM if np.isfinite(slopes.sum()) else _NO_JACOBIAN
            solution = self._solver.solve(data)
        except BaseException as error:  # noqa: BLE001 - through C no exception passes
            keep_fault(error)
            return _NO_ANSWER
        self._local.words = f"{self._solver.name}: {solution.status}"
        if not solution.usable:
            return _NOT_FINITE
        _numbers(out, size + 1)[:] = self._program.after(problem, around, slopes, solution.primal)
        return int(solution.unfinished)


_NO_JACOBIAN, _NO_PROGRAM, _NO_ANSWER, _NOT_FINITE = (
    constants()[f"HYSTMPC_{name}"] for name in ("NO_JACOBIAN", "NO_PROGRAM", "NO_ANSWER", "QP_NOT_FINITE")
)


def _numbers(address: int, count: int) -> Vec:
    return np.ctypeslib.as_array((ctypes.c_double * count).from_address(address))

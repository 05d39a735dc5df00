"""Real-time iteration: linearisation along the best plan, one condensed quadratic program, and a line search."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.models.inverse.inverses import inverted_after_a_hold
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Mat, Vec

from ..command import CommandLimits, CommandPlan, Stopwatch
from ..law_tables import LawTables, MoveBlocking
from ..learning.predictor import LearnedPredictor
from ..mpc import HOLD, INVERSE, Candidates, PlanCost, Planner, PlanningError, PlanningProblem
from ..mpc_settings import LinearisedMpcSettings, WeightsSettings
from .qp import ActiveSetOptions, OsqpOptions, QpData, QpPattern, status_of


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
        self._step, self._after, self._program = engine().plan_step, engine().after_moves, engine().program
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


_SHARES = 3  # of a step, in a line search
# A learned part may be as large as the model: candidates from the model's inverse are then inaccurate.
_LEARNED_ITERATIONS = 2
_KEPT = 0.9  # share of the predicted decrease from which on shorter steps are not tried
_FAULTS = {-5: "the model's Jacobian is not finite", -6: "the quadratic program is not finite"}  # see core/planning.h


def _options_of(settings: LinearisedMpcSettings) -> OsqpOptions | ActiveSetOptions:
    return ActiveSetOptions() if settings.solver == "active_set" else OsqpOptions(eps=settings.solver_eps)


@final
class LinearisedPlanner(Planner[None]):
    """Planner by sequential quadratic programming: one or two iterations per step, safeguarded by the nonlinear cost.

    With an active learned part there are at least two.

    The full step of the program is tried. If the cost falls by clearly less than the linearisation predicts, shorter
    steps are tried in one batched roll-out; the start plan remains if none is better, as across a kink of the play.

    Args:
        options: of the solver, which their class chooses; those of the settings where left out.

    Raises:
        ControllerError: if the blocks do not fit the horizon.
    """

    def __init__(
        self,
        predictor: Predictor,
        settings: LinearisedMpcSettings,
        limits: CommandLimits,
        options: OsqpOptions | ActiveSetOptions | None = None,
    ) -> None:
        self._predictor, self._iterations = predictor, settings.iterations
        weights, dt = settings.weights, predictor.dt
        horizon, blocks = settings.preview_samples(dt), settings.blocks(dt)
        self._cost = PlanCost(weights, horizon)
        blocking = None if blocks is None else MoveBlocking(blocks, horizon)
        self._qp = PlanProgram(weights, limits, horizon, dt, blocking)
        self._options = options or _options_of(settings)
        self._solver = self._options.solver(self._qp.pattern)
        self._parts = engine().parts_of_step

    def init(self) -> None:
        return None

    def improve(
        self, problem: PlanningProblem, start: CommandPlan, memory: None, watch: Stopwatch
    ) -> tuple[CommandPlan, str, None]:
        del memory
        status = "ok"
        for _ in range(max(self._iterations, self._least(problem.state))):
            start, status = self._iterate(problem, start, watch)
        return start, status, None

    def _least(self, state: Vec) -> int:
        predictor = self._predictor
        learned = isinstance(predictor, LearnedPredictor) and predictor.weights(state).any()
        return _LEARNED_ITERATIONS if learned else 1

    def _iterate(self, problem: PlanningProblem, start: CommandPlan, watch: Stopwatch) -> tuple[CommandPlan, str]:
        _, jacobian = self._predictor.linearise(problem.state, start.commands)
        jacobian = np.ascontiguousarray(jacobian, dtype=np.float64)
        watch.lap("linearise")
        if isinstance(self._options, ActiveSetOptions):
            changes, step = self._qp.solved(problem, start, jacobian, self._options.changes)
            if changes < 0:
                raise PlanningError(_FAULTS.get(changes) or f"{self._solver.name}: {status_of(changes)}")
            status = "ok"
        else:
            step, status = self._iterated(problem, start, jacobian)
        watch.lap("solve")
        plan = self._search(problem, start, step[None, :-1], float(step[-1]))
        watch.lap("search")
        return plan, status

    def _iterated(self, problem: PlanningProblem, start: CommandPlan, jacobian: Mat) -> tuple[Vec, str]:
        """Step as of `PlanProgram.solved` by an iterative solver, and the status of the planner."""
        data = self._qp.data(problem, start, jacobian)
        if not math.isfinite(data.hessian.sum() + data.gradient.sum()):
            raise PlanningError(_FAULTS[-6 if math.isfinite(jacobian.sum()) else -5])
        solution = self._solver.solve(data)
        if not solution.usable:
            raise PlanningError(f"{self._solver.name}: {solution.status} after {solution.iterations} iterations")
        status = f"{self._solver.name}: {solution.status}, its best step used" if solution.unfinished else "ok"
        return self._qp.after(problem, start, jacobian, solution.primal), status

    def _search(self, problem: PlanningProblem, start: CommandPlan, whole: Vec, foreseen: float) -> CommandPlan:
        """Cheapest of the start plan and parts of the way to `whole` (1, H), by nonlinear cost."""
        better = self._cheapest(whole, problem)
        if not start.cost - better.cost >= _KEPT * (start.cost - foreseen):  # not-a-number: look further
            parts = np.empty((_SHARES, whole.size))  # admissible: half of a move one way and one the other is none
            self._parts(self._qp.tables.address, start.commands, whole, problem.u_last, parts)
            part = self._cheapest(parts, problem)
            better = part if part.cost < better.cost else better
        return better if better.cost < start.cost else start

    def _cheapest(self, plans: Vec, problem: PlanningProblem) -> CommandPlan:
        return self._cost.best(plans, self._predictor.rollout(problem.state, plans), problem)


_RATE_WEIGHT = 0.01  # at 25 Hz [deg^2 per squared command unit]: negligible against an angle error
_STEADY_RATE_WEIGHT = 3.0  # for models whose exact inverse oscillates: the weight on moves suppresses it
_BASE_DT_S = 0.04
_INVERSE_ITERATIONS = 2


@final
class FeasibleInverse:
    """Inverse over a preview: argmin over admissible u of sum_k (theta_k(u) - r_k)^2, with a small weight on moves.

    It is the problem of the linearised controller without a disturbance. An inverse sample by sample would send u = v +
    (w - v) / a to a lag with step response a < 1, which amplifies every deviation; a delay has no such inverse.
    """

    def __init__(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits, horizon: int) -> None:
        self.horizon = horizon
        rate = _STEADY_RATE_WEIGHT if inverted_after_a_hold(inverse) else _RATE_WEIGHT
        weights = WeightsSettings(terminal=1.0, rate=rate * (_BASE_DT_S / predictor.dt) ** 2, effort=0.0)
        settings = LinearisedMpcSettings(horizon=horizon, iterations=_INVERSE_ITERATIONS, weights=weights)
        self._predictor = predictor
        self._candidates = Candidates(predictor, inverse, limits, horizon)
        self._cost = PlanCost(weights, horizon)
        self._planner = LinearisedPlanner(predictor, settings, limits)

    def plan(self, state: Vec, u_last: float, wanted: Vec, remaining: Vec, tolerance_deg: float) -> CommandPlan:
        """Plan from a model state (S,) along reference angles (H,) [deg], after the rest of the last plan (0..H,).

        A command that keeps the angle within the tolerance over the whole preview is held.

        Raises:
            PlanningError: if the solver fails or predictions are not finite.
        """
        plans = self._candidates.build(state, u_last, wanted, remaining, resting=False)
        angles = self._predictor.rollout(state, plans)
        problem = PlanningProblem(state, u_last, wanted, plans[INVERSE], (-math.inf, math.inf))
        start = self._cost.best(plans, angles, problem)
        if not math.isfinite(start.cost):
            raise PlanningError(f"none of {len(plans)} candidates has a finite prediction")
        if np.max(np.abs(angles[HOLD] - wanted)) <= tolerance_deg:
            return CommandPlan(plans[HOLD], angles[HOLD], start.cost)
        return self._planner.improve(problem, start, None, Stopwatch())[0]

"""Real-time iteration: linearisation along the best plan, one condensed quadratic program, and a line search."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hystmpc.models.inverse.inverses import Bounds, clip_plans, inverted_after_a_hold
from hystmpc.models.kernels.numba_ import njit
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Mat, Vec

from ..command import CommandLimits, CommandPlan, Stopwatch
from ..learning.predictor import LearnedPredictor
from ..mpc import HOLD, INVERSE, Candidates, PlanCost, Planner, PlanningError, PlanningProblem
from ..mpc_settings import LinearisedMpcSettings, WeightsSettings
from .qp import DaqpOptions, OsqpOptions, QpData, QpPattern


class PlanProgram(ABC):
    """Quadratic program around a plan, and the commands of its solution."""

    pattern: QpPattern
    _weights: WeightsSettings

    @abstractmethod
    def data(self, problem: PlanningProblem, around: CommandPlan, jacobian: Mat) -> QpData:
        """Return the program around the plan `around` with Jacobian (H, H), lower triangular [deg per command unit]."""

    @abstractmethod
    def blocked(self, problem: PlanningProblem, around: CommandPlan, columns: Mat) -> QpData:
        """Return the program around the plan `around` with J M = `columns` (H, m), which start with their blocks."""

    @abstractmethod
    def deviation(self, primal: Vec) -> Vec:
        """Return the deviation of the commands from the plan (H,) in a solution z = `primal`."""

    def _softened(self, hard: QpData, problem: PlanningProblem, around: CommandPlan, entries: Vec) -> QpData:
        """Add soft angle limits to the program with hard limits; `entries` of their rows, column by column."""
        low, high = problem.angle_limits
        none = np.zeros(around.angles.size)
        constraint_data = np.array(self.pattern.constraints.data, dtype=np.float64)
        constraint_data[self.pattern.moving] = entries
        return QpData(
            np.concatenate([hard.hessian_data, none + 2.0 * self._weights.soft_limit]),
            np.concatenate([hard.gradient, none]),
            np.concatenate([hard.lower, low - around.angles]),
            np.concatenate([hard.upper, high - around.angles]),
            constraint_data,
            np.concatenate([hard.dual, none]),
        )


@final
class TrackingQp(PlanProgram):
    """Quadratic program of the planning cost with linearised angles, in the deviation v of the commands from a plan p.

        theta(p + v) ~ theta_p + J v
        P = 2 (J'QJ + w_r D'D + w_e I),  q = 2 (J'Q (theta_p - r) + w_r D'(D p - e_1 u_last) + w_e (p - f))
        lower <= p + v <= upper,  -rate dt <= D (p + v) - e_1 u_last <= rate dt

    with D the difference matrix. Soft angle limits add H free variables s with cost w_s s^2 and the rows
    a <= theta_p + J v + s <= b, which is the squared distance to [a, b] exactly.

    Multipliers start at values that hold a plan already at the greatest rate: stationarity D'y = -q, solved backwards
    in time, of the right sign, and zero where the rate limit is not touched. First-order methods take thousands of
    iterations to find these, and the best candidates of a reversal touch the limit over many samples.
    """

    def __init__(self, weights: WeightsSettings, limits: CommandLimits, horizon: int, dt: float) -> None:
        self._weights, self._horizon = weights, horizon
        self._soft = weights.limits_angle
        self._tracking = weights.over(horizon)
        self._factors = np.array((weights.rate, weights.effort, limits.lower, limits.upper, limits.rate * dt))
        self._triangle = horizon * (horizon + 1) // 2
        # the Jacobian is lower triangular; column by column its entries are those of the transpose, row by row
        self._columns = np.triu_indices(horizon)
        rows = np.vstack([np.eye(horizon), np.eye(horizon) - np.eye(horizon, k=-1)])
        self.pattern = _pattern(rows, np.tril(np.ones((horizon, horizon))) if self._soft else None)

    def data(self, problem: PlanningProblem, around: CommandPlan, jacobian: Mat) -> QpData:
        size = self._horizon
        hessian, gradient = np.empty(self._triangle), np.empty(size)
        lower, upper, dual = np.empty((3, 2 * size))
        tracking_program(
            jacobian,
            around.angles,
            problem.reference,
            around.commands,
            problem.feedforward,
            problem.u_last,
            self._tracking,
            self._factors,
            hessian,
            gradient,
            lower,
            upper,
            dual,
        )
        hard = QpData(hessian, gradient, lower, upper, None, dual)
        return self._softened(hard, problem, around, jacobian.T[self._columns]) if self._soft else hard

    def blocked(self, problem: PlanningProblem, around: CommandPlan, columns: Mat) -> QpData:
        return self.data(problem, around, columns)  # every sample is a block: M is the identity

    def deviation(self, primal: Vec) -> Vec:
        return primal[: self._horizon]


@dataclass(frozen=True)
class MoveBlocking:
    """Move blocking (Cagienard et al., 2007): deviations v = M w (H,) from a plan, with one w for each block.

        v_k = w_{b-1} + (k - s_b + 1) / L_b (w_b - w_{b-1})   in block b of length L_b from sample s_b on,  w_{-1} = 0
        v_k = w_{m-1}                                         after the last block

    That is offset blocking of the moves: within a block the deviation's move is constant, after the last one zero. A
    block of held commands would have to make its whole move in one sample, whose rate is limited; here a block of L
    samples moves by up to L times as much. The plan itself, the best candidate, is not blocked.

    Raises:
        ControllerError: if there is no block, one is shorter than a sample, or they are longer than the horizon.
    """

    lengths: tuple[int, ...]  # L, samples in each block, the first one first
    horizon: int  # H

    def __post_init__(self) -> None:
        if not self.lengths or min(self.lengths) < 1 or sum(self.lengths) > self.horizon:
            raise ControllerError(
                f"move_blocking: got blocks of {list(self.lengths)} samples, {sum(self.lengths)} together, expected at "
                f"least one, each of at least 1 sample, together at most the horizon of {self.horizon}"
            )

    @property
    def starts(self) -> NDArray[np.intp]:
        """First sample s (m,) of each block."""
        return np.cumsum((0, *self.lengths[:-1]))

    @property
    def ends(self) -> NDArray[np.intp]:
        """Last sample of each block (m,), at which v equals w."""
        return np.cumsum(self.lengths) - 1

    @property
    def matrix(self) -> Mat:
        """Blocking matrix M (H, m)."""
        count = len(self.lengths)
        matrix = np.zeros((self.horizon, count))
        for b, (start, length) in enumerate(zip(self.starts.tolist(), self.lengths, strict=True)):
            along = np.arange(1, length + 1) / length
            matrix[start : start + length, b] = along
            if b:
                matrix[start : start + length, b - 1] = 1.0 - along
        matrix[sum(self.lengths) :, count - 1] = 1.0
        return matrix


@final
class BlockedQp(PlanProgram):
    """Quadratic program `TrackingQp` with move blocking: deviations w (m,) at the ends of blocks, v = M w.

        P = 2 ((J M)'Q (J M) + w_r (D M)'D M + w_e M'M),  q = M' q_full
        lower <= p + M w <= upper in every sample
        L_b (-rate dt - min D p) <= w_b - w_{b-1} <= L_b (rate dt - max D p),  min and max over block b

    The move of v is constant in a block, so the rate of all its samples is one row. Soft angle limits add H slacks.
    """

    def __init__(self, weights: WeightsSettings, limits: CommandLimits, blocking: MoveBlocking, dt: float) -> None:
        self._weights, self._limits, self._reach = weights, limits, limits.rate * dt
        self._soft = weights.limits_angle
        self._matrix, self._starts, self._ends = blocking.matrix, blocking.starts, blocking.ends
        horizon = blocking.horizon
        self._between = np.setdiff1d(np.arange(horizon), self._ends)
        self._doubled = 2.0 * weights.over(horizon)
        difference = np.eye(horizon) - np.eye(horizon, k=-1)
        self._by_move = 2.0 * weights.rate * (difference @ self._matrix)
        self._by_command = 2.0 * weights.effort * self._matrix
        self._constant = (difference @ self._matrix).T @ self._by_move + self._matrix.T @ self._by_command
        count = self._starts.size
        rows = np.vstack([np.eye(count), np.eye(count) - np.eye(count, k=-1), self._matrix[self._between]])
        self.pattern = _pattern(rows, np.ones((horizon, count)) if self._soft else None)

    def data(self, problem: PlanningProblem, around: CommandPlan, jacobian: Mat) -> QpData:
        columns = np.empty(self._matrix.shape)
        block_columns(jacobian, self._matrix, self._starts, columns)
        return self.blocked(problem, around, columns)

    def blocked(self, problem: PlanningProblem, around: CommandPlan, columns: Mat) -> QpData:
        plan, count = around.commands, self._starts.size
        moves, off = moves_of(plan, problem.u_last), plan - problem.feedforward
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
        return self._softened(hard, problem, around, columns.T.ravel()) if self._soft else hard

    def deviation(self, primal: Vec) -> Vec:
        deviation: Vec = self._matrix @ primal[: self._starts.size]
        return deviation


def _pattern(rows: Mat, angles: Mat | None) -> QpPattern:
    """Sparsity pattern from the rows of the hard limits (N, n) and the nonzeros (H, n) of the soft limits."""
    count = rows.shape[1]
    hessian = sparse.csc_matrix(np.triu(np.ones((count, count))))
    if angles is None:
        return QpPattern(hessian, sparse.csc_matrix(rows), np.empty(0, dtype=np.intp), count)
    marker, slacks = 2.0, sparse.eye(len(angles))  # marker that differs from the other entries, which are at most one
    blocks = [[sparse.csc_matrix(rows), None], [sparse.csc_matrix(marker * angles), slacks]]
    constraints = sparse.csc_matrix(sparse.bmat(blocks, format="csc"))
    hessian = sparse.csc_matrix(sparse.block_diag([hessian, slacks], format="csc"))
    return QpPattern(hessian, constraints, np.flatnonzero(constraints.data == marker), count)


@njit(cache=True, error_model="numpy", nogil=True)
def moves_of(plan: Any, u_last: float) -> Any:
    """Moves of a plan, D p - e_1 u_last (H,)."""
    moves = plan.copy()
    moves[0] -= u_last
    for k in range(1, plan.size):
        moves[k] -= plan[k - 1]
    return moves


@njit(cache=True, error_model="numpy", nogil=True)
def all_finite(hessian: Any, gradient: Any) -> Any:
    """Whether all numbers are finite, by their sum."""
    return np.isfinite(hessian.sum() + gradient.sum())


@njit(cache=True, error_model="numpy", nogil=True)
def tracking_program(
    jacobian: Any,
    angles: Any,
    reference: Any,
    plan: Any,
    feedforward: Any,
    u_last: float,
    tracking: Any,
    factors: Any,
    hessian: Any,
    gradient: Any,
    lower: Any,
    upper: Any,
    dual: Any,
) -> None:
    """Hard limits' part of `TrackingQp` around a plan, in place; factors: rate, effort, least, greatest, reach."""
    size, reach = plan.size, factors[4]
    moves = moves_of(plan, u_last)
    condense(jacobian, angles - reference, tracking, moves, plan - feedforward, factors, hessian, gradient)
    for k in range(size):
        lower[k], upper[k], dual[k] = factors[2] - plan[k], factors[3] - plan[k], 0.0
        lower[size + k], upper[size + k] = -reach - moves[k], reach - moves[k]
    dual[size:] = rate_multipliers(gradient, moves, reach)


@njit(cache=True, error_model="numpy", nogil=True)
def condense(
    jacobian: Any, error: Any, tracking: Any, moves: Any, off: Any, weights: Any, hessian: Any, gradient: Any
) -> None:
    """Compute gradient (H,) and upper triangle (H (H + 1) / 2,) of `TrackingQp`, column by column, in place.

    jacobian (H, H) is lower triangular; moves = D p - e_1 u_last and off = p - f, each (H,); weights: rate, effort.
    """
    size, at = error.size, 0
    rate, effort = 2.0 * weights[0], 2.0 * weights[1]
    for i in range(size):
        total = effort * off[i] + rate * moves[i]
        if i + 1 < size:
            total -= rate * moves[i + 1]
        for j in range(i + 1):
            hessian[at + j] = 0.0
        for k in range(i, size):
            weighted = 2.0 * tracking[k] * jacobian[k, i]
            total += weighted * error[k]
            for j in range(i + 1):
                hessian[at + j] += weighted * jacobian[k, j]
        hessian[at + i] += effort + (2.0 * rate if i + 1 < size else rate)
        if i:
            hessian[at + i - 1] -= rate
        gradient[i] = total
        at += i + 1


@njit(cache=True, error_model="numpy", nogil=True)
def rate_multipliers(gradient: Any, moves: Any, reach: float) -> Any:
    """Compute the multipliers (H,) that hold a plan at the greatest rate where it already has it; see `TrackingQp`."""
    dual = np.zeros(gradient.size)
    balance, touching = 0.0, reach * (1.0 - 1e-6)
    for k in range(gradient.size - 1, -1, -1):
        balance -= gradient[k]
        if moves[k] >= touching:
            dual[k] = max(balance, 0.0)
        elif moves[k] <= -touching:
            dual[k] = min(balance, 0.0)
    return dual


@njit(cache=True, error_model="numpy", nogil=True)
def block_columns(jacobian: Any, blocking: Any, starts: Any, columns: Any) -> None:
    """Compute J M (H, m) in place, for lower triangular J (H, H) and M of `MoveBlocking.matrix`."""
    horizon, count = blocking.shape
    for b in range(count):
        stop = starts[b + 2] if b + 2 < count else horizon
        for k in range(horizon):
            total = 0.0
            for i in range(starts[b], min(k + 1, stop)):
                total += jacobian[k, i] * blocking[i, b]
            columns[k, b] = total


@njit(cache=True, error_model="numpy", nogil=True)
def condense_blocked(columns: Any, starts: Any, weighted: Any, constant: Any, gradient: Any, hessian: Any) -> None:
    """Compute gradient (m,) += 2 (J M)'Q e and the upper triangle of `constant` + 2 (J M)'Q J M, by columns, in place.

    columns: J M (H, m); weighted (2, H): 2 Q, and 2 Q e.
    """
    horizon, count = columns.shape
    at = 0
    for b in range(count):
        for k in range(starts[b], horizon):
            gradient[b] += weighted[1, k] * columns[k, b]
        for a in range(b + 1):
            total = constant[a, b]
            for k in range(starts[b], horizon):
                total += weighted[0, k] * columns[k, a] * columns[k, b]
            hessian[at] = total
            at += 1


@njit(cache=True, error_model="numpy", nogil=True)
def block_room(moves: Any, starts: Any, ends: Any, reach: float, low: Any, high: Any, extreme: Any) -> None:
    """Compute bounds of the difference between deviations at the ends of neighbouring blocks (m,), in place.

    The deviation's move is the same in all samples of a block: the largest move of the plan in the block decides.
    extreme: the move of the plan (m,) nearest to a limit. The plan is admissible but for rounding, so zero always is.
    """
    for b in range(starts.size):
        least, most = moves[starts[b]], moves[starts[b]]
        for k in range(starts[b] + 1, ends[b] + 1):
            least, most = min(least, moves[k]), max(most, moves[k])
        length = ends[b] + 1 - starts[b]
        low[b] = length * min(-reach - least, 0.0)
        high[b] = length * max(reach - most, 0.0)
        extreme[b] = most if most >= -least else least


_PARTS = np.array([0.5, 0.25, 0.125])
# A learned part may be as large as the model: candidates from the model's inverse are then inaccurate.
_LEARNED_ITERATIONS = 2
_KEPT = 0.9  # share of the predicted decrease from which on shorter steps are not tried


def _options_of(settings: LinearisedMpcSettings) -> OsqpOptions | DaqpOptions:
    return DaqpOptions() if settings.solver == "daqp" else OsqpOptions(eps=settings.solver_eps)


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
        options: OsqpOptions | DaqpOptions | None = None,
    ) -> None:
        self._predictor, self._iterations = predictor, settings.iterations
        weights, dt = settings.weights, predictor.dt
        self._bounds = Bounds(limits.lower, limits.upper, limits.rate * dt)
        horizon, blocks = settings.preview_samples(dt), settings.blocks(dt)
        self._cost = PlanCost(weights, horizon)
        self._qp: PlanProgram = TrackingQp(weights, limits, horizon, dt)
        if blocks is not None:
            self._qp = BlockedQp(weights, limits, MoveBlocking(blocks, horizon), dt)
        self._solver = (options or _options_of(settings)).solver(self._qp.pattern)

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
        watch.lap("linearise")
        data = self._qp.data(problem, start, jacobian)
        if not all_finite(data.hessian_data, data.gradient):
            fault = "quadratic program" if math.isfinite(jacobian.sum()) else "model's Jacobian"
            raise PlanningError(f"the {fault} is not finite")
        solution = self._solver.solve(data)
        watch.lap("solve")
        if not solution.usable:
            raise PlanningError(f"{self._solver.name}: {solution.status} after {solution.iterations} iterations")
        plan = self._search(problem, start, jacobian, self._qp.deviation(solution.primal))
        watch.lap("search")
        return plan, f"{self._solver.name}: {solution.status}, its best step used" if solution.unfinished else "ok"

    def _search(self, problem: PlanningProblem, start: CommandPlan, jacobian: Vec, step: Vec) -> CommandPlan:
        """Cheapest of the start plan and parts of the step, by nonlinear cost."""
        # the solver overshoots limits within its tolerance: clip the whole step, parts are then too
        whole, foreseen = np.empty((2, 1, step.size))
        take_step(start.commands, start.angles, jacobian, step, *self._bounds, problem.u_last, whole, foreseen)
        better = self._cheapest(whole, problem)
        promised = start.cost - self._cost(whole, foreseen, problem)[0]
        if not start.cost - better.cost >= _KEPT * promised:  # not-a-number: look further
            parts = start.commands + _PARTS[:, None] * (
                whole - start.commands
            )  # half of a move one way and one the other is none
            clip_plans(parts, *self._bounds, problem.u_last)
            part = self._cheapest(parts, problem)
            better = part if part.cost < better.cost else better
        return better if better.cost < start.cost else start

    def _cheapest(self, plans: Vec, problem: PlanningProblem) -> CommandPlan:
        return self._cost.best(plans, self._predictor.rollout(problem.state, plans), problem)


@njit(cache=True, error_model="numpy", nogil=True)
def take_step(
    commands: Any,
    angles: Any,
    jacobian: Any,
    step: Any,
    low: float,
    high: float,
    reach: float,
    u_last: float,
    whole: Any,
    foreseen: Any,
) -> None:
    """Compute the plan after a step (1, H), made admissible, and its angles (1, H) by the linearisation, in place."""
    for k in range(step.size):
        whole[0, k] = commands[k] + step[k]
    clip_plans(whole, low, high, reach, u_last)
    for k in range(step.size):
        foreseen[0, k] = angles[k]
        for j in range(k + 1):
            foreseen[0, k] += jacobian[k, j] * (whole[0, j] - commands[j])


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

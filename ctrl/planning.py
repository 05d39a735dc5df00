"""Plans of the predictive controllers: the problem, its cost, candidate plans, and the protocol of a planner."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, final

import numpy as np

from hystmpc.models.inverse.follow import Bounds, Follower, clip_plans, follower_for
from hystmpc.models.kernels.numba_ import njit
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec

from .command import Stopwatch
from .learning.predictor import LearnedFollower, LearnedInverse
from .limits import CommandLimits
from .planning_settings import WeightsSettings

P = TypeVar("P")

HOLD, INVERSE = 0, 1  # rows of the candidates that callers refer to

FOLLOWING = 5  # rows before those that only search

_ROUNDING = 1e-9  # share of the greatest step: which samples a plan is postponed by must not hang on rounding

# Shares of the greatest step. Inside what a network has for a dead band its slope may have the wrong sign: the little
# step that ends an error in a hold is found by trying it, not by a gradient.
_STEPS = (0.125, 0.1875, 0.25, 0.375, 0.5, 0.625, 0.75, 1.0)


class PlanningError(RuntimeError):
    """No plan was found; caught by the fallback chain, never leaves the step."""


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """One planning problem; every angle in it is the model's, that is without the output disturbance."""

    state: Vec  # predictor state (S,) at which the plan starts to act
    u_last: float  # the command really sent last
    reference: Vec  # wanted angles [deg], shape (H,)
    feedforward: Vec  # the inverse plan, from which effort is measured, shape (H,)
    angle_limits: tuple[float, float]  # soft limits of the angle [deg], lower and upper


@dataclass(frozen=True, eq=False)
class CommandPlan:
    """Admissible commands (H,), the model's angles along them (H,) [deg], and their cost."""

    commands: Vec
    angles: Vec
    cost: float


@final
class PlanCost:
    """The one cost that candidates, line search and samples are ranked by.

        J(u) = sum_k q_k (theta_k - r_k)^2 + w_s dist(theta_k, [a, b])^2 + w_r (u_k - u_{k-1})^2 + w_e (u_k - f_k)^2

    with u_{-1} the command really sent last, [a, b] the soft angle limits and f the inverse plan.
    """

    def __init__(self, weights: WeightsSettings, horizon: int) -> None:
        soft = weights.soft_limit if weights.limits_angle else 0.0
        self._factors = float(weights.rate), float(weights.effort), float(soft)
        self._tracking = weights.over(horizon)

    def __call__(self, plans: Vec, angles: Vec, problem: PlanningProblem) -> Vec:
        """Costs (N,) of the plans (N, H) whose angles are (N, H); infinite where a prediction is not finite."""
        found: Vec = costs(*self._arguments(plans, angles, problem))
        return found

    def best(self, plans: Vec, angles: Vec, problem: PlanningProblem) -> CommandPlan:
        """The cheapest of the plans; its cost is infinite where no prediction is finite."""
        row, cost = cheapest(*self._arguments(plans, angles, problem))
        return CommandPlan(plans[row], angles[row], cost)

    def _arguments(self, plans: Vec, angles: Vec, problem: PlanningProblem) -> tuple[Any, ...]:
        low, high = problem.angle_limits
        known = problem.reference, problem.feedforward, problem.u_last, self._tracking
        return plans, angles, *known, *self._factors, low, high


class Planner(ABC, Generic[P]):
    """Improves a plan; the result never costs more than the plan it starts from."""

    @abstractmethod
    def init(self) -> P:
        """The planner's memory before its first plan (dual variables, random counter)."""

    @abstractmethod
    def improve(
        self, problem: PlanningProblem, start: CommandPlan, memory: P, watch: Stopwatch
    ) -> tuple[CommandPlan, str, P]:
        """The better plan, `ok` or one line on what was unusual, and the next memory.

        Raises:
            PlanningError: if the solver fails or predictions are not finite.
        """


@final
class Candidates:
    """Admissible plans (N, H):

    hold; inverse, as fast as the rate limit allows once the reference asks for it; inverse ahead of time, so that
    a dead band is crossed before the reference turns; inverse half ahead, so that the crossing has its middle at
    the turn; the last plan, shifted; reversals: m = 2, 4, ... samples at the greatest rate in either direction and
    then rest; and where the reference rests, small steps: a share of a sample at the greatest rate, either way.
    """

    def __init__(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits, horizon: int) -> None:
        self._horizon = horizon
        reach = limits.rate * predictor.dt
        self._bounds = Bounds(limits.lower, limits.upper, reach)
        if isinstance(inverse, LearnedInverse):
            self._follower: Follower = LearnedFollower(inverse)
        else:
            self._follower = follower_for(predictor, inverse)
        self._reversals = _reversals(reach, horizon)
        steps = np.repeat(reach * np.array(_STEPS)[:, None], horizon, axis=1)
        self._all = np.concatenate([self._reversals, steps, -steps])

    @property
    def searching(self) -> int:
        """Greatest number of plans beside the first five."""
        return len(self._all)

    def build(self, state: Vec, u_last: float, reference: Vec, remaining: Vec, resting: bool = True) -> Vec:
        """The plans that may follow `u_last` for the model angles `reference` (H,) [deg].

        Args:
            remaining: what is left of the last plan, shape (0..H,).
            resting: whether small steps are among them.

        Raises:
            PlanningError: if the reference is not as long as the horizon.
        """
        if reference.shape != (self._horizon,):
            raise PlanningError(f"reference: got {reference.shape} angles, expected ({self._horizon},), the horizon")
        low, high, reach = self._bounds
        ramps = self._all if resting else self._reversals
        plans = np.empty((FOLLOWING + len(ramps), self._horizon))
        targets = self._follower.follow(state, reference, u_last, self._bounds)
        fill_candidates(plans, targets, remaining, ramps, u_last, reach)
        clip_plans(plans, low, high, reach, u_last)
        return plans


def _reversals(reach: float, horizon: int) -> Vec:
    """Offsets (M, H) from the last command: m = 2, 4, ... samples at the greatest rate, up and down."""
    lengths = [2**i for i in range(1, horizon.bit_length()) if 2**i <= max(horizon // 2, 2)]
    ramps = reach * np.minimum(np.arange(1, horizon + 1), np.array(lengths)[:, None])
    return np.concatenate([ramps, -ramps])


@njit(cache=True, error_model="numpy", nogil=True)
def run_ahead(plan: Any, reach: float) -> None:
    """Limited in rate backwards in time, in place: every move of the plan (H,) starts early enough to arrive."""
    for k in range(plan.size - 2, -1, -1):
        plan[k] = min(max(plan[k], plan[k + 1] - reach), plan[k + 1] + reach)


@njit(cache=True, error_model="numpy", nogil=True)
def postpone_half(plan: Any, u_last: float, reach: float) -> None:
    """The first jump of the plan (H,) later by half of the samples that it takes at the greatest rate, in place."""
    before = u_last
    for k in range(plan.size):
        jump = plan[k] - before
        if abs(jump) > reach * (1.0 + _ROUNDING):
            half = int(np.ceil(abs(jump) / reach - _ROUNDING)) // 2
            for j in range(k, min(k + half, plan.size)):
                plan[j] = before
            return
        before = plan[k]


@njit(cache=True, error_model="numpy", nogil=True)
def fill_candidates(plans: Any, targets: Any, remaining: Any, ramps: Any, u_last: float, reach: float) -> None:
    """The rows of `Candidates`, not yet clipped: five plans and `ramps` (M, H) from the last command.

    targets (2, H): the inverse within the box, and within the rate limit.
    """
    horizon, left = plans.shape[1], remaining.size
    for k in range(horizon):
        plans[0, k] = u_last
        plans[1, k] = targets[1, k]
        plans[2, k] = targets[0, k]
        plans[3, k] = targets[0, k]
        if left:
            plans[4, k] = remaining[min(k, left - 1)]
        else:
            plans[4, k] = targets[1, k]
    postpone_half(plans[3], u_last, reach)
    run_ahead(plans[2], reach)
    run_ahead(plans[3], reach)
    for n in range(ramps.shape[0]):
        for k in range(horizon):
            plans[5 + n, k] = u_last + ramps[n, k]


@njit(cache=True, error_model="numpy", nogil=True)
def costs(
    plans: Any,
    angles: Any,
    reference: Any,
    inverse: Any,
    u_last: float,
    tracking: Any,
    rate: float,
    effort: float,
    soft: float,
    low: float,
    high: float,
) -> Any:
    """Costs (N,) of `PlanCost`, infinite where they are not finite; low, high: the soft angle limits."""
    found = np.empty(plans.shape[0])
    for n in range(plans.shape[0]):
        total, before = 0.0, u_last
        for k in range(plans.shape[1]):
            error, move, off = angles[n, k] - reference[k], plans[n, k] - before, plans[n, k] - inverse[k]
            total += tracking[k] * error * error + rate * move * move + effort * off * off
            if soft > 0.0:
                excess = max(angles[n, k] - high, 0.0) + max(low - angles[n, k], 0.0)
                total += soft * excess * excess
            before = plans[n, k]
        found[n] = total if np.isfinite(total) else np.inf
    return found


@njit(cache=True, error_model="numpy", nogil=True)
def cheapest(
    plans: Any,
    angles: Any,
    reference: Any,
    inverse: Any,
    u_last: float,
    tracking: Any,
    rate: float,
    effort: float,
    soft: float,
    low: float,
    high: float,
) -> Any:
    """The first plan of the lowest cost, and that cost; see `costs`."""
    found = costs(plans, angles, reference, inverse, u_last, tracking, rate, effort, soft, low, high)
    row = np.argmin(found)
    return row, found[row]

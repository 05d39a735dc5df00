"""What the predictive controllers share: the planning problem, its cost, and what a planner is."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar, final

import numpy as np

from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from .plan_kernels import costs
from .stopwatch import Stopwatch

P = TypeVar("P")


class PlanningError(RuntimeError):
    """No plan was found; caught by the ladder, never leaves the step."""


@dataclass(frozen=True)
class Weights:
    """Weights of the planning cost.

    Attributes:
        tracking: squared angle error [1/deg^2].
        terminal: factor on `tracking` at the last sample.
        rate: squared command change per sample [1/mm^2 or 1/bar^2].
        effort: squared distance from the inverse plan [1/mm^2 or 1/bar^2].
        soft_limit: squared excess over the soft angle limits [1/deg^2].
        angle_limits_deg: soft limits of the angle [deg]; infinite for none.

    Raises:
        ControllerError: if a weight is negative or not finite, `tracking` or `rate` is zero, or the limits cross.
    """

    tracking: float = 1.0
    terminal: float = 2.0
    rate: float = 3.0
    effort: float = 0.01
    soft_limit: float = 100.0
    angle_limits_deg: tuple[float, float] = (-math.inf, math.inf)

    def __post_init__(self) -> None:
        for name in ("tracking", "terminal", "rate", "effort", "soft_limit"):
            value = getattr(self, name)
            positive = name in ("tracking", "rate")
            if not math.isfinite(value) or value < 0 or (positive and value == 0):
                raise ControllerError(f"weights: got {name} {value}, expected finite, {'>' if positive else '>='} 0")
        low, high = self.angle_limits_deg
        if not low < high:
            raise ControllerError(f"weights: got angle_limits_deg {low} to {high}, expected lower < upper")

    @property
    def limits_angle(self) -> bool:
        """Whether there is a soft angle limit at all."""
        return self.soft_limit > 0 and any(math.isfinite(v) for v in self.angle_limits_deg)

    def over(self, horizon: int) -> Vec:
        """Tracking weights along the horizon, shape (H,)."""
        along = np.full(horizon, self.tracking)
        along[-1] *= self.terminal
        return along


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """One planning problem; every angle in it is the model's, that is without the output disturbance.

    Attributes:
        state: predictor state (S,) at which the plan starts to act.
        u_last: the command really sent last.
        reference: wanted angles [deg], shape (H,).
        feedforward: the inverse plan, from which effort is measured, shape (H,).
        angle_limits: soft limits of the angle [deg], lower and upper.
    """

    state: Vec
    u_last: float
    reference: Vec
    feedforward: Vec
    angle_limits: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Plan:
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

    def __init__(self, weights: Weights, horizon: int) -> None:
        soft = weights.soft_limit if weights.limits_angle else 0.0
        self._factors = weights.rate, weights.effort, soft
        self._tracking = weights.over(horizon)

    def __call__(self, plans: Vec, angles: Vec, problem: PlanningProblem) -> Vec:
        """Costs (N,) of the plans (N, H) whose angles are (N, H); infinite where a prediction is not finite."""
        factors = np.array((*self._factors, *problem.angle_limits))
        found: Vec = costs(
            plans, angles, problem.reference, problem.feedforward, problem.u_last, self._tracking, factors
        )
        return found

    def best(self, plans: Vec, angles: Vec, problem: PlanningProblem) -> Plan:
        """The cheapest of the plans; its cost is infinite where no prediction is finite."""
        found = self(plans, angles, problem)
        row = int(np.argmin(found))
        return Plan(plans[row], angles[row], float(found[row]))


class Planner(ABC, Generic[P]):
    """Improves a plan; the result never costs more than the plan it starts from."""

    @abstractmethod
    def init(self) -> P:
        """The planner's memory before its first plan (dual variables, random counter)."""

    @abstractmethod
    def improve(self, problem: PlanningProblem, start: Plan, memory: P, watch: Stopwatch) -> tuple[Plan, str, P]:
        """The better plan, `ok` or one line on what was unusual, and the next memory.

        Raises:
            PlanningError: if the solver fails or predictions are not finite.
        """

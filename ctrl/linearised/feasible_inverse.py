"""The inverse of a model with lag or delay: the commands within the limits that follow a previewed reference best."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from hystmpc.models.inverse.one_step import inverted_after_a_hold
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec

from ..command import CommandLimits, CommandPlan, Stopwatch
from ..mpc import HOLD, INVERSE, Candidates, PlanCost, PlanningError, PlanningProblem
from ..mpc_settings import LinearisedMpcSettings
from ..planning_settings import WeightsSettings
from .planner import LinearisedPlanner

_RATE_WEIGHT = 0.01  # at 25 Hz [deg^2 per squared command unit]: next to nothing beside an error of the angle
_STEADY_RATE_WEIGHT = 3.0  # of a model whose exact inverse goes back and forth: what a move costs keeps it from that
_BASE_DT_S = 0.04
_ITERATIONS = 2


@final
class FeasibleInverse:
    """argmin over admissible u of the sum of (theta_k(u) - r_k)^2 over the preview, with next to no weight on moves.

    The problem of the linearised controller without a disturbance: its candidates, then its planner. Sample by sample,
    an inverse would send u = v + (w - v) / a to a lag of which a share a < 1 shows in a sample, which amplifies every
    deviation, and could send nothing sensible to a delay.
    """

    def __init__(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits, horizon: int) -> None:
        self.horizon = horizon
        rate = _STEADY_RATE_WEIGHT if inverted_after_a_hold(inverse) else _RATE_WEIGHT
        weights = WeightsSettings(terminal=1.0, rate=rate * (_BASE_DT_S / predictor.dt) ** 2, effort=0.0)
        settings = LinearisedMpcSettings(horizon=horizon, iterations=_ITERATIONS, weights=weights)
        self._predictor = predictor
        self._candidates = Candidates(predictor, inverse, limits, horizon)
        self._cost = PlanCost(weights, horizon)
        self._planner = LinearisedPlanner(predictor, settings, limits)

    def plan(self, state: Vec, u_last: float, wanted: Vec, remaining: Vec, tolerance_deg: float) -> CommandPlan:
        """The plan from a model state (S,) along wanted angles (H,) [deg].

        A command that keeps the angle within the tolerance over the whole preview is held.

        Args:
            remaining: what is left of the last plan, shape (0..H,).

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

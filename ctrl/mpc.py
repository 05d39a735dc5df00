"""The predictive law: candidates, their roll-out, a planner that improves the best of them, and holds that hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar, final

from hystmpc.models.model import Predictor
from hystmpc.trials.types import Vec

from .candidates import FOLLOWING, HOLD, INVERSE, Candidates
from .command import Source
from .hold import Hold, HoldRule
from .ladder import attempt
from .law import Law, Proposal, Situation
from .planning import Plan, PlanCost, Planner, PlanningError, PlanningProblem, Weights
from .slope import mean_slope
from .stopwatch import Stopwatch

P = TypeVar("P")


@dataclass(frozen=True)
class PredictiveMemory(Generic[P]):
    """The planner's memory, and the hold."""

    planner: P
    hold: Hold


@final
class PredictiveLaw(Law[PredictiveMemory[P]]):
    """Model-predictive control with any planner (architecture, section 4, steps 3 and 4).

    The disturbance d is constant over the horizon, so the plan makes the model follow theta_ref - d. While a
    constant reference is reached, the command does not move at all: otherwise noise in d would ratchet the play
    along, since one direction of every small correction is free and the other costs a whole dead band.
    """

    source = Source.MPC

    def __init__(
        self,
        predictor: Predictor,
        candidates: Candidates,
        planner: Planner[P],
        weights: Weights,
        horizon: int,
        hold: HoldRule,
    ) -> None:
        self.horizon = horizon
        self._predictor, self._candidates, self._planner = predictor, candidates, planner
        self._angle_limits = weights.angle_limits_deg
        self._cost = PlanCost(weights, horizon)
        self._hold = hold
        self._slope = attempt(lambda: mean_slope(predictor))[0] or 0.0  # a model may fail where no plan ever is

    def init(self, y: float, u: float) -> PredictiveMemory[P]:
        del y, u
        return PredictiveMemory(self._planner.init(), Hold())

    def propose(
        self, memory: PredictiveMemory[P], situation: Situation, watch: Stopwatch
    ) -> Proposal[PredictiveMemory[P]]:
        wanted, resting = situation.reference - situation.disturbance, memory.hold.constant > 0
        plans = self._candidates.build(situation.state, situation.u_last, wanted, situation.remaining_plan, resting)
        watch.lap("candidates")
        low, high = self._angle_limits
        problem = PlanningProblem(
            state=situation.state,
            u_last=situation.u_last,
            reference=wanted,
            feedforward=plans[INVERSE],
            angle_limits=(low - situation.disturbance, high - situation.disturbance),
        )
        first = plans[:FOLLOWING] if resting else plans  # at rest most steps hold, and look no further
        angles = self._predictor.rollout(situation.state, first)
        held = angles[HOLD] + situation.disturbance
        hold = self._hold.judge(memory.hold, situation.reference, held, situation.disturbance_sigma)
        start = self._start(problem, plans, angles, hold.holding)
        watch.lap("rollout")
        if not math.isfinite(start.cost):
            raise PlanningError(f"none of {len(plans)} candidates has a finite prediction")
        if hold.holding:
            return self._proposal(start, "ok", PredictiveMemory(memory.planner, hold))
        plan, status, planner = self._planner.improve(problem, start, memory.planner, watch)
        commands = self._hold.gentle(hold, plan.commands, situation.u_last, self._hold.error(hold, held), self._slope)
        if commands is not plan.commands:
            plan = Plan(commands, self._predictor.rollout(situation.state, commands[None])[0], plan.cost)
        return self._proposal(plan, status, PredictiveMemory(planner, hold))

    def _start(self, problem: PlanningProblem, plans: Vec, angles: Vec, holding: bool) -> Plan:
        """The held command in a hold, else the cheapest candidate; `angles` are known of the first few."""
        known = HOLD + 1 if holding else len(angles)
        best = self._cost.best(plans[:known], angles[:known], problem)
        if holding or known == len(plans):
            return best
        others = plans[known:]
        found = self._cost.best(others, self._predictor.rollout(problem.state, others), problem)
        return found if found.cost < best.cost else best

    @staticmethod
    def _proposal(plan: Plan, status: str, memory: PredictiveMemory[P]) -> Proposal[PredictiveMemory[P]]:
        return Proposal(float(plan.commands[0]), memory, plan.commands, plan.angles, status)

"""The predictive law: candidates, their roll-out, a planner that improves the best of them, and holds that hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar, final

import numpy as np
from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ControllerError
from numpy.typing import NDArray

from .candidates import HOLD, INVERSE, Candidates
from .command import Source
from .law import Law, Proposal, Situation
from .planning import Plan, PlanCost, Planner, PlanningError, PlanningProblem, Weights
from .stopwatch import Stopwatch

Vec = NDArray[np.float64]
P = TypeVar("P")

_LEAVE_SIGMAS = 5.0  # two independent estimates of one disturbance differ by more than this once in 10^4 samples


@dataclass(frozen=True)
class HoldOptions:
    """When a constant reference counts as reached.

    Attributes:
        tolerance_deg: a hold begins when the held command keeps the angle this close over the whole horizon.
        noise_deg: standard deviation of the disturbance estimate; a hold ends five of these beyond the tolerance.

    Raises:
        ControllerError: if a value is negative.
    """

    tolerance_deg: float = 0.03
    noise_deg: float = 0.0

    def __post_init__(self) -> None:
        if not (self.tolerance_deg >= 0 and self.noise_deg >= 0):
            raise ControllerError(
                f"hold: got tolerance_deg {self.tolerance_deg}, noise_deg {self.noise_deg}, expected both >= 0"
            )

    def settled(self, reference: Vec, held_angles: Vec, holding: bool) -> bool:
        """Whether to hold: the reference (H,) is constant and the held command's angles (H,) are close to it."""
        if np.ptp(reference) > self.tolerance_deg:
            return False
        allowed = self.tolerance_deg + (_LEAVE_SIGMAS * self.noise_deg if holding else 0.0)
        return bool(np.max(np.abs(held_angles - reference)) <= allowed)


@dataclass(frozen=True)
class PredictiveMemory(Generic[P]):
    """The planner's memory, and whether the last command was a hold on purpose."""

    planner: P
    holding: bool


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
        hold: HoldOptions,
    ) -> None:
        self.horizon = horizon
        self._predictor, self._candidates, self._planner = predictor, candidates, planner
        self._angle_limits = weights.angle_limits_deg
        self._cost = PlanCost(weights, horizon)
        self._hold = hold

    def init(self, y: float, u: float) -> PredictiveMemory[P]:
        del y, u
        return PredictiveMemory(self._planner.init(), False)

    def propose(
        self, memory: PredictiveMemory[P], situation: Situation, watch: Stopwatch
    ) -> Proposal[PredictiveMemory[P]]:
        wanted = situation.reference - situation.disturbance
        plans = self._candidates.build(situation.state, situation.u_last, wanted, situation.remaining_plan)
        watch.lap("candidates")
        low, high = self._angle_limits
        problem = PlanningProblem(
            state=situation.state,
            u_last=situation.u_last,
            reference=wanted,
            feedforward=plans[INVERSE],
            angle_limits=(low - situation.disturbance, high - situation.disturbance),
        )
        angles = self._predictor.rollout(situation.state, plans)
        holding = self._hold.settled(wanted, angles[HOLD], memory.holding)
        chosen = plans[HOLD : HOLD + 1] if holding else plans
        start = self._cost.best(chosen, angles[: len(chosen)], problem)
        watch.lap("rollout")
        if not math.isfinite(start.cost):
            raise PlanningError(f"none of {len(chosen)} candidates has a finite prediction")
        if holding:
            return self._proposal(start, "ok", PredictiveMemory(memory.planner, True))
        plan, status, planner = self._planner.improve(problem, start, memory.planner, watch)
        return self._proposal(plan, status, PredictiveMemory(planner, False))

    @staticmethod
    def _proposal(plan: Plan, status: str, memory: PredictiveMemory[P]) -> Proposal[PredictiveMemory[P]]:
        return Proposal(float(plan.commands[0]), memory, plan.commands, plan.angles, status)

"""The predictive law: candidates, their roll-out, a planner that improves the best of them, and holds that hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ControllerError

from .candidates import HOLD, INVERSE, Candidates
from .command import Source
from .law import Law, Proposal, Situation
from .planning import Plan, PlanCost, Planner, PlanningError, PlanningProblem, Weights
from .stopwatch import Stopwatch

Vec = NDArray[np.float64]
P = TypeVar("P")

_LEAVE_SIGMAS = 5.0  # two independent estimates of one disturbance differ by more than this once in 10^4 samples
_ENTER_SIGMAS = 2.0


@dataclass(frozen=True)
class Hold:
    """Whether the command is held on purpose, and for how many samples the preview has been constant."""

    holding: bool = False
    constant: int = 0


@dataclass(frozen=True)
class HoldRule:
    """When a constant reference counts as reached: the held command keeps the angle close over the whole horizon.

    Close is `tolerance_deg` at first; with patience, `tolerance_deg` and two standard deviations of the disturbance
    estimate, since noise may never let it come closer; once held, five.

    Attributes:
        tolerance_deg: closeness that is always good enough [deg].
        patience: samples of constant preview after which noise is allowed for.

    Raises:
        ControllerError: if a value is negative.
    """

    tolerance_deg: float = 0.03
    patience: int = 10

    def __post_init__(self) -> None:
        if not (self.tolerance_deg >= 0 and self.patience >= 0):
            raise ControllerError(f"hold: got {self}, expected values >= 0")

    def rests(self, reference: Vec) -> bool:
        """Whether the preview (H,) [deg] is constant."""
        return float(reference.max() - reference.min()) <= self.tolerance_deg

    def judge(self, before: Hold, reference: Vec, held_angles: Vec, sigma: float) -> Hold:
        """Whether to hold now, from the preview (H,) [deg] and the held command's angles (H,) [deg].

        `sigma` is the standard deviation of the disturbance estimate's error [deg].
        """
        if not self.rests(reference):
            return Hold()
        constant = before.constant + 1
        sigmas = _LEAVE_SIGMAS if before.holding else _ENTER_SIGMAS if constant > self.patience else 0.0
        error = float(np.max(np.abs(held_angles - reference)))
        return Hold(error <= self.tolerance_deg + sigmas * sigma, constant)


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

    def init(self, y: float, u: float) -> PredictiveMemory[P]:
        del y, u
        return PredictiveMemory(self._planner.init(), Hold())

    def propose(
        self, memory: PredictiveMemory[P], situation: Situation, watch: Stopwatch
    ) -> Proposal[PredictiveMemory[P]]:
        wanted = situation.reference - situation.disturbance
        plans = self._candidates.build(
            situation.state, situation.u_last, wanted, situation.remaining_plan, self._hold.rests(wanted)
        )
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
        hold = self._hold.judge(memory.hold, wanted, angles[HOLD], situation.disturbance_sigma)
        chosen = plans[HOLD : HOLD + 1] if hold.holding else plans
        start = self._cost.best(chosen, angles[: len(chosen)], problem)
        watch.lap("rollout")
        if not math.isfinite(start.cost):
            raise PlanningError(f"none of {len(chosen)} candidates has a finite prediction")
        if hold.holding:
            return self._proposal(start, "ok", PredictiveMemory(memory.planner, hold))
        plan, status, planner = self._planner.improve(problem, start, memory.planner, watch)
        return self._proposal(plan, status, PredictiveMemory(planner, hold))

    @staticmethod
    def _proposal(plan: Plan, status: str, memory: PredictiveMemory[P]) -> Proposal[PredictiveMemory[P]]:
        return Proposal(float(plan.commands[0]), memory, plan.commands, plan.angles, status)

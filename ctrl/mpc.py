"""The predictive law: candidate plans, a planner that improves the best of them, the hold at a constant reference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar, final

import numpy as np

from hystmpc.models.inverse.drive import DrivenInverse
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec

from .analysis import static_gain
from .command import ControlInput, Source, Stopwatch
from .fallback import attempt
from .law import Law, Proposal
from .learning.predictor import LearnedInverse
from .limits import CommandLimits
from .planning import (
    FOLLOWING,
    HOLD,
    INVERSE,
    Candidates,
    CommandPlan,
    PlanCost,
    Planner,
    PlanningError,
    PlanningProblem,
)
from .planning_settings import HoldSettings, PredictiveSettings

_LEAVE_SIGMAS = 5.0  # two independent estimates of one disturbance differ by more than this once in 10^4 samples

P = TypeVar("P")


@dataclass(frozen=True)
class PredictiveMemory(Generic[P]):
    """The planner's memory, and the hold."""

    planner: P
    hold: Hold


@final
class PredictiveLaw(Law[PredictiveMemory[P]]):
    """Model-predictive control with any planner.

    The disturbance d is constant over the horizon, so the plan makes the model follow theta_ref - d. While a
    constant reference is reached, the command does not move at all: otherwise noise in d would ratchet the play
    along, since one direction of every small correction is free and the other costs a whole dead band.
    """

    source = Source.MPC

    def __init__(
        self,
        predictor: Predictor,
        inverse: Inverse,
        limits: CommandLimits,
        planner: Planner[P],
        settings: PredictiveSettings,
    ) -> None:
        self.horizon = settings.preview_samples(predictor.dt)
        self._predictor, self._planner, self._limits = predictor, planner, limits
        self._candidates = Candidates(predictor, inverse, limits, self.horizon)
        self._angle_limits = settings.weights.angle_limits_deg
        self._cost = PlanCost(settings.weights, self.horizon)
        known = inverse.inverse if isinstance(inverse, LearnedInverse) else inverse
        delay = known.delay_samples if isinstance(known, DrivenInverse) else 0
        step = predictor.noise.sensor_resolution_deg if predictor.noise else 0.0
        self.rule = HoldRule(settings.hold, predictor.dt, delay, step)
        self.slope = attempt(lambda: static_gain(predictor))[0] or 0.0  # a model may fail where no plan ever is

    def init(self, y: float, u: float) -> PredictiveMemory[P]:
        del y, u
        return PredictiveMemory(self._planner.init(), Hold())

    def propose(
        self, memory: PredictiveMemory[P], given: ControlInput, watch: Stopwatch
    ) -> Proposal[PredictiveMemory[P]]:
        wanted, resting = given.reference - given.disturbance, memory.hold.constant > 0
        plans = self._candidates.build(given.state, given.u_last, wanted, given.remaining_plan, resting)
        watch.lap("candidates")
        low, high = self._angle_limits
        problem = PlanningProblem(
            state=given.state,
            u_last=given.u_last,
            reference=wanted,
            feedforward=plans[INVERSE],
            angle_limits=(low - given.disturbance, high - given.disturbance),
        )
        first = plans[:FOLLOWING] if resting else plans  # at rest most steps hold, and look no further
        angles = self._predictor.rollout(given.state, first)
        held = angles[HOLD] + given.disturbance
        hold = self.rule.judge(memory.hold, given.reference, held, given.disturbance_sigma)
        start = self._start(problem, plans, angles, hold.holding)
        watch.lap("rollout")
        if not math.isfinite(start.cost):
            raise PlanningError(f"none of {len(plans)} candidates has a finite prediction")
        if hold.holding:
            return self._proposal(start, "ok", PredictiveMemory(memory.planner, hold))
        plan, status, planner = self._planner.improve(problem, start, memory.planner, watch)
        commands = plan.commands
        if self.rule.settles(hold):
            commands = self.rule.gentle(hold, commands, given.u_last, self.rule.error(hold, held), self.slope)
        if commands is not plan.commands:
            commands = self._limits.clip_plans(commands, given.u_last, self._predictor.dt)
            plan = CommandPlan(commands, self._predictor.rollout(given.state, commands[None])[0], plan.cost)
        return self._proposal(plan, status, PredictiveMemory(planner, hold))

    def _start(self, problem: PlanningProblem, plans: Vec, angles: Vec, holding: bool) -> CommandPlan:
        """The held command in a hold, else the cheapest candidate; `angles` are known of the first few."""
        known = HOLD + 1 if holding else len(angles)
        best = self._cost.best(plans[:known], angles[:known], problem)
        if holding or known == len(plans):
            return best
        others = plans[known:]
        found = self._cost.best(others, self._predictor.rollout(problem.state, others), problem)
        return found if found.cost < best.cost else best

    @staticmethod
    def _proposal(plan: CommandPlan, status: str, memory: PredictiveMemory[P]) -> Proposal[PredictiveMemory[P]]:
        return Proposal(float(plan.commands[0]), memory, plan.commands, plan.angles, status)


@dataclass(frozen=True)
class Hold:
    """Whether the command is held on purpose, at which reference, and for how many samples that has been constant."""

    holding: bool = False
    constant: int = 0
    target: float = math.nan


@final
class HoldRule:
    """When a constant reference counts as reached, and how an error that is left over is worked off.

    A reference is constant while it and what the preview shows of the next `lead` samples stay within `tolerance_deg`
    of the angle at which they came to rest. Reached it is where the held command keeps the angle close: within
    `tolerance_deg` at first; and with every `patience` that passes one standard deviation of the disturbance estimate
    more, up to five, since noise may never let it come closer and a command has to come to rest; once held, five.

    A reading of a sensor with steps q stays where it is while the angle moves within q / 2 of it. At rest the estimate
    goes there from what the motion has told, and corrections would creep until the reading flips, and come back: a
    limit cycle. Once held, q more is close enough: an angle within q / 2 of the wanted one is never left, and one more
    than 3 q / 2 away always is.

    A command that shows `delay` samples later has to leave that much earlier; `lead` counts from there.

    A longer lead would let the command cross the dead band before the reference turns. On a dead band as flat as the
    model's that is free; on a device that answers there, it moves the tip in a hold.
    """

    def __init__(self, settings: HoldSettings, dt: float, delay: int = 0, step_deg: float = 0.0) -> None:
        self._tolerance, self._step = settings.tolerance_deg, step_deg
        self._patience, self._lead = round(settings.patience_s / dt), delay + max(round(settings.lead_s / dt), 1)
        self._settle_after, self._settle = round(settings.settle_after_s / dt), round(settings.settle_s / dt)

    def numbers(self) -> Mapping[str, float]:
        """Numbers of the rule, for the same rule in another language."""
        return {
            "hold_tolerance": self._tolerance,
            "hold_step": self._step,
            "hold_patience": max(self._patience, 1),
            "hold_lead": self._lead,
            "hold_settle_after": self._settle_after,
            "hold_settle": self._settle,
            "leave_sigmas": _LEAVE_SIGMAS,
        }

    def judge(self, before: Hold, reference: Vec, held: Vec, sigma: float) -> Hold:
        """Whether to hold now.

        Args:
            held: angles (H,) that the held command is expected to lead to [deg].
            sigma: standard deviation of the disturbance estimate's error [deg].
        """
        now = float(reference[0])
        if not abs(now - before.target) <= self._tolerance:  # not-a-number: none yet
            return Hold(target=now)
        if self._lead > 1 and self.error(before, reference[: self._lead]) > self._tolerance:
            return Hold(target=now)
        constant = before.constant + 1
        waited = min(float(constant // max(self._patience, 1)), _LEAVE_SIGMAS)
        more = _LEAVE_SIGMAS * sigma + self._step if before.holding else waited * sigma
        return Hold(self.error(before, held) <= self._tolerance + more, constant, before.target)

    @staticmethod
    def error(hold: Hold, held: Vec) -> float:
        """Greatest distance of angles (H,) from the angle to be held [deg]."""
        return float(np.max(np.abs(held - hold.target)))

    def settles(self, hold: Hold) -> bool:
        """Whether an error that is left over is worked off by now."""
        return self._settle > 0 and hold.constant > self._settle_after

    def gentle(self, hold: Hold, plan: Vec, u_last: float, error: float, slope: float) -> Vec:
        """The plan (H,), in a hold within u_last -+ k error / (slope settle), k = 1, 2, ... samples.

        Inside what a model has for a dead band and a device does not, a plan takes a whole dead band for free, and the
        plan after it takes it back: a limit cycle. A correction as small as the error asks for outside dead bands meets
        the measurement before it is too far, and a true dead band is crossed all the same, within some samples more.

        Args:
            error: greatest error of the held command [deg].
            slope: static gain of the model [deg per command unit].
        """
        if not (self.settles(hold) and slope > 0):
            return plan
        most = error / (slope * self._settle) * np.arange(1, plan.size + 1)
        return np.clip(plan, u_last - most, u_last + most)

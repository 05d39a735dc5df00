"""Predictive control law: planning problem, cost, candidate plans, interface of planners, and hold rule."""

from __future__ import annotations

import ctypes
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Generic, TypeVar, final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.models.inverse.drive import DrivenInverse
from hystmpc.models.inverse.inverses import Follower, follower_for
from hystmpc.models.model import Inverse, Predictor, static_gain
from hystmpc.trials.types import Vec

from .command import CommandLimits, CommandPlan, ControlInput, Source, Stopwatch, attempt
from .guarded import Law, Proposal
from .law_tables import LawTables
from .learning.predictor import LearnedFollower, LearnedInverse
from .mpc_settings import HoldSettings, PredictiveSettings, WeightsSettings

P = TypeVar("P")

HOLD, INVERSE = 0, 1  # rows of the candidates that callers use

FOLLOWING = 5  # rows before those that only search

_STEPS = 8  # small steps either way


class PlanningError(RuntimeError):
    """Failure of planning; caught by the fallback chain, never leaves the step."""


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


class Planner(ABC, Generic[P]):
    """Planner that improves a start plan; its result never costs more than the start plan."""

    @abstractmethod
    def init(self) -> P:
        """Return the planner's memory before its first plan (dual variables, random counter)."""

    @abstractmethod
    def improve(
        self, problem: PlanningProblem, start: CommandPlan, memory: P, watch: Stopwatch
    ) -> tuple[CommandPlan, str, P]:
        """Return an improved plan, `ok` or one line on a handled failure, and the next memory.

        Raises:
            PlanningError: if the solver fails or predictions are not finite.
        """


@final
class Candidates:
    """Admissible candidate plans (N, H) from which planning starts.

    They are: hold; inverse, as fast as the rate limit allows once the reference asks for it; inverse ahead of time, so
    that a dead band is crossed before the reference turns; inverse half ahead, so that the crossing has its middle at
    the turn; the last plan, shifted; reversals: m = 2, 4, ... samples at the greatest rate in either direction and then
    rest; and where the reference rests, small steps: a share of a sample at the greatest rate, either way.

    Inside what a network has for a dead band its slope may have the wrong sign: the little step that ends an error in a
    hold is chosen by a trial, not by a gradient.

    Attributes:
        searching: greatest number of plans besides the first five.
    """

    def __init__(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits, horizon: int) -> None:
        self._tables = LawTables(WeightsSettings(), horizon, limits, predictor.dt)
        if isinstance(inverse, LearnedInverse):
            self._follower: Follower = LearnedFollower(inverse)
        else:
            self._follower = follower_for(predictor, inverse)
        lengths = [2**i for i in range(1, horizon.bit_length()) if 2**i <= max(horizon // 2, 2)]
        self.searching = 2 * (len(lengths) + _STEPS)
        self._fill = engine().fill_candidates

    def build(self, state: Vec, u_last: float, reference: Vec, remaining: Vec, resting: bool = True) -> Vec:
        """Compute the candidate plans that may follow `u_last`, for the model angles `reference` (H,) [deg].

        Args:
            remaining: remaining commands of the last plan, shape (0..H,).

        Raises:
            PlanningError: if the reference is not as long as the horizon.
        """
        horizon = self._tables.horizon
        if reference.shape != (horizon,):
            raise PlanningError(f"reference: got {reference.shape} angles, expected ({horizon},), the horizon")
        plans = np.empty((FOLLOWING + self.searching, horizon))
        targets = self._follower.follow(state, reference, u_last, self._tables.bounds)
        count = self._fill(self._tables.address, targets, remaining, remaining.size, u_last, resting, plans)
        return plans[:count]


_LEAVE_SIGMAS = 5.0  # the difference of two independent estimates of one disturbance exceeds this once in 10^4 samples


@dataclass(frozen=True)
class PredictiveMemory(Generic[P]):
    """Memory of the planner, and state of the hold."""

    planner: P
    hold: Hold


@final
class PredictiveLaw(Law[PredictiveMemory[P]]):
    """Model-predictive control law with any planner.

    The disturbance d is constant over the horizon, so the model follows theta_ref - d. At a reached constant reference
    the command is constant: otherwise noise in d would move the play step by step, since small corrections in one
    direction cost nothing and those in the other a whole dead band.
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
            commands = self.rule.limited_correction(
                hold, commands, given.u_last, self.rule.error(hold, held), self.slope
            )
        if commands is not plan.commands:
            commands = self._limits.clip_plans(commands, given.u_last, self._predictor.dt)
            plan = CommandPlan(commands, self._predictor.rollout(given.state, commands[None])[0], plan.cost)
        return self._proposal(plan, status, PredictiveMemory(planner, hold))

    def _start(self, problem: PlanningProblem, plans: Vec, angles: Vec, holding: bool) -> CommandPlan:
        """Start plan: the held command in a hold, else the cheapest candidate; `angles` of the first candidates."""
        known = HOLD + 1 if holding else len(angles)
        best = self._cost.best(plans[:known], angles[:known], problem)
        if holding or known == len(plans):
            return best
        others = plans[known:]
        searched = self._cost.best(others, self._predictor.rollout(problem.state, others), problem)
        return searched if searched.cost < best.cost else best

    @staticmethod
    def _proposal(plan: CommandPlan, status: str, memory: PredictiveMemory[P]) -> Proposal[PredictiveMemory[P]]:
        return Proposal(float(plan.commands[0]), memory, plan.commands, plan.angles, status)


@dataclass(frozen=True)
class Hold:
    """Hold state: whether the command is held, at which reference, and number of samples of constant reference."""

    holding: bool = False
    constant: int = 0
    target: float = math.nan


@final
class HoldRule:
    """Rule that holds the command at a constant reference, and corrects a remaining error slowly.

    A reference is constant while it and its next `lead` samples stay within `tolerance_deg` of the angle at which they
    came to rest. It is reached while the held command keeps the angle within `tolerance_deg`, plus one standard
    deviation of the disturbance estimate per elapsed `patience`, up to five, since noise may prevent a closer approach;
    once held, five.

    A reading with resolution q is constant while the angle stays within q / 2 of it. At rest the estimate drifts to the
    reading, and corrections would continue until the reading changes, then reverse: a limit cycle. Once held, q more is
    close enough: an angle within q / 2 of the wanted one is never left, and one more than 3 q / 2 away always is.

    A command that acts `delay` samples later has to start that much earlier; `lead` counts from there. A longer lead
    would let the command cross the dead band before the reference turns. On a dead band as flat as the model's that is
    free; on a device that answers there, it moves the tip in a hold.
    """

    def __init__(self, settings: HoldSettings, dt: float, delay: int = 0, step_deg: float = 0.0) -> None:
        self._tolerance, self._step = settings.tolerance_deg, step_deg
        self._patience, self._lead = round(settings.patience_s / dt), delay + max(round(settings.lead_s / dt), 1)
        self._settle_after, self._settle = round(settings.settle_after_s / dt), round(settings.settle_s / dt)

    def numbers(self) -> Mapping[str, float]:
        """Return the numbers of the rule, for code generation."""
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
        """Return the hold state of this sample.

        Args:
            held: predicted angles (H,) under the held command [deg].
            sigma: standard deviation of the disturbance estimate's error [deg].
        """
        now = float(reference[0])
        if not abs(now - before.target) <= self._tolerance:  # not-a-number: no target yet
            return Hold(target=now)
        if self._lead > 1 and self.error(before, reference[: self._lead]) > self._tolerance:
            return Hold(target=now)
        constant = before.constant + 1
        waited = min(float(constant // max(self._patience, 1)), _LEAVE_SIGMAS)
        more = _LEAVE_SIGMAS * sigma + self._step if before.holding else waited * sigma
        return Hold(self.error(before, held) <= self._tolerance + more, constant, before.target)

    @staticmethod
    def error(hold: Hold, held: Vec) -> float:
        """Return the greatest distance of angles (H,) from the held angle [deg]."""
        return float(np.max(np.abs(held - hold.target)))

    def settles(self, hold: Hold) -> bool:
        """Whether a remaining error is now corrected slowly."""
        return self._settle > 0 and hold.constant > self._settle_after

    def limited_correction(self, hold: Hold, plan: Vec, u_last: float, error: float, slope: float) -> Vec:
        """Return the plan (H,), in a hold within u_last -+ k error / (slope settle), k = 1, 2, ... samples.

        If the model has a dead band that the device does not have, a plan crosses it at no cost and the next plan
        returns: a limit cycle. A correction of the size needed outside dead bands is checked by the measurement in
        time; a true dead band is still crossed, some samples later.

        Args:
            error: greatest error of the held command [deg].
            slope: static gain of the model [deg per command unit].
        """
        if not (self.settles(hold) and slope > 0):
            return plan
        most = error / (slope * self._settle) * np.arange(1, plan.size + 1)
        return np.clip(plan, u_last - most, u_last + most)

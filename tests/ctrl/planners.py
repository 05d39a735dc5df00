"""The engine's planners on one planning problem, as a controller calls them, and programs that they solve."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass, replace

import numpy as np

from hystmpc.core.library import engine
from hystmpc.core.structs import layout
from hystmpc.ctrl.answers import planner_words
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.linearised.program import IterativeSolution, PlanningTask, PlanProgram
from hystmpc.ctrl.linearised.qp import OsqpOptions, QpData, QpSolution
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, SamplingMpcSettings, WeightsSettings
from hystmpc.ctrl.problem import CHANGES, is_first_guess, problem_of
from hystmpc.models.model import Predictor
from hystmpc.trials.types import Vec

from .plays import DT, Case

LIMITS = CommandLimits(0.0, 6.0, 4.0)
SOFT_DEG = (25.0, 42.0)
_UNFINISHED = -4


@dataclass(frozen=True, eq=False)
class Problem:
    """A task, and an admissible plan to begin with: the model's state, commands (H,) and their angles (H,)."""

    state: Vec
    task: PlanningTask
    commands: Vec
    angles: Vec

    def at(self, predictor: Predictor, commands: Vec) -> Problem:
        """The same with another plan."""
        return replace(self, commands=commands, angles=predictor.rollout(self.state, commands[None])[0])

    def program(self, program: PlanProgram, predictor: Predictor) -> QpData:
        """The program around the plan."""
        jacobian = predictor.linearise(self.state, self.commands)[1]
        return program.data(self.task, self.commands, self.angles, jacobian)

    def cost(self, weights: WeightsSettings, commands: Vec, angles: Vec) -> float:
        """The planning cost of a plan, written once more."""
        task, horizon = self.task, commands.size
        excess = np.maximum(angles - task.angle_limits[1], 0.0) + np.maximum(task.angle_limits[0] - angles, 0.0)
        soft = weights.soft_limit if weights.limits_angle else 0.0
        moves = np.diff(commands, prepend=task.u_last)
        terms = weights.over(horizon) * (angles - task.reference) ** 2 + task.rate_weight * moves**2
        return float(np.sum(terms + weights.effort * (commands - task.feedforward) ** 2 + soft * excess**2))


def posed(case: Case, horizon: int, seed: int = 0) -> Problem:
    """A random problem and plan."""
    random = np.random.default_rng(seed)
    state, u_last = case.predictor.initial(40.0, 2.0), 2.0
    commands = LIMITS.clip_plans(u_last + np.cumsum(random.normal(0, 0.1, horizon)), u_last, DT)
    task = PlanningTask(u_last, 1.0, 40.0 + np.cumsum(random.normal(0, 3.0, horizon)), commands - 0.05, SOFT_DEG)
    return Problem(state, task, commands, case.predictor.rollout(state, commands[None])[0])


@dataclass(frozen=True, eq=False)
class Improved:
    """What a planner answers: a plan (H,), its angles (H,) and cost, 0, 1 or why there is none, its steps so far."""

    commands: Vec
    angles: Vec
    cost: float
    answer: int
    draws: int

    @property
    def words(self) -> str:
        """Why there is no plan."""
        return planner_words(self.answer)


class Planner:
    """The planner of a predictive controller with these settings; `options` solve its programs by OSQP."""

    def __init__(
        self,
        case: Case,
        settings: LinearisedMpcSettings | SamplingMpcSettings,
        predictor: Predictor | None = None,
        options: OsqpOptions | None = None,
    ) -> None:
        self._weights = settings.weights.discounted(is_first_guess(case.inverse))
        settings = settings.model_copy(update={"adaptation": None, "supervisor": None})
        solve, predictor = None, predictor or case.predictor
        if options is not None:
            settings = settings.model_copy(update={"solver": "osqp"})
            horizon, blocks = settings.preview_samples(DT), settings.blocks(DT)
            solve = IterativeSolution(self._weights, LIMITS, horizon, DT, blocks, options)
        self._controller = problem_of(settings, predictor, case.inverse, LIMITS, solve=solve)
        self._planner, self._model = self._controller.fields["law"].fields["planner"], self._controller.fields["model"]

    def improve(self, problem: Problem, draws: int = 0) -> Improved:
        """The problem's plan improved once, in the step of a random planner that is counted so."""
        commands, angles = problem.commands.copy(), problem.angles.copy()
        cost, count = problem.cost(self._weights, commands, angles), ctypes.c_int64(draws)
        best = layout("hystmpc_plan")(commands.ctypes.data, angles.ctypes.data, cost if cost == cost else math.inf)
        core, known = engine(), (self._planner.address, self._model.address)
        room = np.empty(core.planner_bytes(*known), dtype=np.uint8)
        places = problem.task.part.address, ctypes.addressof(best), ctypes.addressof(count)
        with np.errstate(all="ignore"):
            answer = core.improve(*known, problem.state, *places, room)
        return Improved(commands, angles, best.cost, answer, count.value)


def exact(data: QpData, changes: int = CHANGES) -> QpSolution:
    """The program's solution by the engine's active-set method."""
    unknowns, rows = data.columns.shape
    room = np.empty(engine().qp_bytes(unknowns, rows, int((data.soft > 0.0).sum())), dtype=np.uint8)
    primal = np.full(unknowns, np.nan)
    program = data.hessian, data.gradient, data.columns, data.lower, data.upper, data.soft
    answer = engine().quadratic_program(unknowns, rows, *program, changes, room, primal)
    status = "solved" if answer >= 0 else planner_words(answer)
    return QpSolution(primal, answer >= 0, status, max(answer, 0), answer == _UNFINISHED)

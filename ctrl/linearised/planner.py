"""Real-time iteration: linearise along the best plan, solve one quadratic program, search along its answer."""

from __future__ import annotations

import math
from typing import Any, final

import numpy as np

from hystmpc.models.inverse.follow import Bounds, clip_plans
from hystmpc.models.kernels.numba_ import njit
from hystmpc.models.model import Predictor
from hystmpc.trials.types import Vec

from ..command import CommandLimits, Stopwatch
from ..learning.predictor import LearnedPredictor
from ..mpc import CommandPlan, PlanCost, Planner, PlanningError, PlanningProblem
from ..mpc_settings import LinearisationSettings
from .daqp_ import DaqpOptions, DaqpSolver
from .osqp_ import OsqpOptions, OsqpSolver
from .program import BlockedQp, MoveBlocking, PlanProgram, QpSolver, TrackingQp

_PARTS = np.array([0.5, 0.25, 0.125])
# A learned part may well be as large as the model: candidates that follow the model's inverse are then far off.
_LEARNED_ITERATIONS = 2
_KEPT = 0.9  # share of the promised decrease from which on no part of the step is worth a roll-out


@final
class LinearisedPlanner(Planner[None]):
    """Sequential-quadratic-programming iterations, one or two in a step, guarded by the nonlinear cost.

    Where a learned part acts there are at least two.

    The program's step is tried whole, and where the cost falls by clearly less than the linearisation promised, in
    parts too, in one batched roll-out; the start plan wins where none is better, as across a kink of the play.

    Args:
        options: of the solver, which their class chooses; those of the settings where left out.

    Raises:
        ControllerError: if the blocks do not fit the horizon.
    """

    def __init__(
        self,
        predictor: Predictor,
        settings: LinearisationSettings,
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
        if options is None:
            options = DaqpOptions() if settings.solver == "daqp" else OsqpOptions(eps=settings.solver_eps)
        pattern = self._qp.pattern
        self._solver: QpSolver = (
            OsqpSolver(pattern, options) if isinstance(options, OsqpOptions) else DaqpSolver(pattern, options)
        )

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
        """Iterations that a plan needs, whatever the settings say."""
        predictor = self._predictor
        learned = isinstance(predictor, LearnedPredictor) and predictor.weights(state).any()
        return _LEARNED_ITERATIONS if learned else 1

    def _iterate(self, problem: PlanningProblem, start: CommandPlan, watch: Stopwatch) -> tuple[CommandPlan, str]:
        _, jacobian = self._predictor.linearise(problem.state, start.commands)
        watch.lap("linearise")
        data = self._qp.data(problem, start, jacobian)
        if not data.finite:
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
        """The cheapest of the start plan and parts of the step, by nonlinear cost."""
        # the solver overshoots limits within its tolerance: clip the whole step, parts are then too
        whole, foreseen = np.empty((2, 1, step.size))
        take_step(start.commands, start.angles, jacobian, step, *self._bounds, problem.u_last, whole, foreseen)
        found = self._cheapest(whole, problem)
        promised = start.cost - self._cost(whole, foreseen, problem)[0]
        if not start.cost - found.cost >= _KEPT * promised:  # not-a-number: look further
            parts = start.commands + _PARTS[:, None] * (
                whole - start.commands
            )  # half of a move one way and one the other is none
            clip_plans(parts, *self._bounds, problem.u_last)
            part = self._cheapest(parts, problem)
            found = part if part.cost < found.cost else found
        return found if found.cost < start.cost else start

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
    """The plan after a step (1, H), made admissible, and its angles (1, H) as the linearisation has them, in place."""
    for k in range(step.size):
        whole[0, k] = commands[k] + step[k]
    clip_plans(whole, low, high, reach, u_last)
    for k in range(step.size):
        foreseen[0, k] = angles[k]
        for j in range(k + 1):
            foreseen[0, k] += jacobian[k, j] * (whole[0, j] - commands[j])

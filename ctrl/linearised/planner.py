"""Real-time iteration: linearise along the best plan, solve one quadratic program, search along its answer."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ControllerError

from ..limits import CommandLimits
from ..planning import Plan, PlanCost, Planner, PlanningError, PlanningProblem, Weights
from ..stopwatch import Stopwatch
from .daqp_ import DaqpOptions, DaqpSolver
from .osqp_ import OsqpOptions, OsqpSolver
from .problem import QpPattern, TrackingQp
from .solver import QpSolver

Vec = NDArray[np.float64]

_STEPS = np.array([1.0, 0.5, 0.25, 0.125])


@final
class LinearisedPlanner(Planner[None]):
    """One or two sequential-quadratic-programming iterations per step, guarded by the nonlinear cost.

    The program's step is tried whole and in parts in one batched roll-out; the start plan wins where none is
    better, as across a kink of the play, where the linearisation is wrong.

    Args:
        predictor: the model.
        weights: weights of the cost.
        limits: hard limits.
        horizon: H.
        iterations: linearisations per step.
        options: of the solver, which their class chooses; DAQP where left out.

    Raises:
        ControllerError: if `iterations` is less than 1.
    """

    def __init__(
        self,
        predictor: Predictor,
        weights: Weights,
        limits: CommandLimits,
        horizon: int,
        iterations: int = 1,
        options: OsqpOptions | DaqpOptions | None = None,
    ) -> None:
        if iterations < 1:
            raise ControllerError(f"linearised MPC: got iterations {iterations}, expected at least 1")
        self._predictor, self._limits, self._iterations = predictor, limits, iterations
        self._cost = PlanCost(weights, horizon)
        self._qp = TrackingQp(weights, limits, horizon, predictor.dt)
        self._solver = _solver(self._qp.pattern, options)

    def init(self) -> None:
        return None

    def improve(self, problem: PlanningProblem, start: Plan, memory: None, watch: Stopwatch) -> tuple[Plan, str, None]:
        del memory
        status = "ok"
        for _ in range(self._iterations):
            start, status = self._iterate(problem, start, watch)
        return start, status, None

    def _iterate(self, problem: PlanningProblem, start: Plan, watch: Stopwatch) -> tuple[Plan, str]:
        _, jacobian = self._predictor.linearise(problem.state, start.commands)
        watch.lap("linearise")
        if not np.all(np.isfinite(jacobian)):
            raise PlanningError("the model's Jacobian is not finite")
        data = self._qp.data(problem, start, jacobian)
        if not (np.all(np.isfinite(data.hessian_data)) and np.all(np.isfinite(data.gradient))):
            raise PlanningError("the quadratic program is not finite")
        solution = self._solver.solve(data)
        watch.lap("solve")
        if not solution.usable:
            raise PlanningError(f"{self._solver.name}: {solution.status} after {solution.iterations} iterations")
        plan = self._search(problem, start, solution.primal[: start.commands.size])
        watch.lap("search")
        return plan, f"{self._solver.name}: {solution.status}, its best step used" if solution.unfinished else "ok"

    def _search(self, problem: PlanningProblem, start: Plan, step: Vec) -> Plan:
        """The cheapest of the start plan and parts of the step, by nonlinear cost."""
        # the solver overshoots limits within its tolerance: clip the whole step, parts of it are then admissible
        target = self._limits.clip_plans(start.commands + step, problem.u_last, self._predictor.dt)
        plans = start.commands + _STEPS[:, None] * (target - start.commands)
        found = self._cost.best(plans, self._predictor.rollout(problem.state, plans), problem)
        return found if found.cost < start.cost else start


def _solver(pattern: QpPattern, options: OsqpOptions | DaqpOptions | None) -> QpSolver:
    if isinstance(options, OsqpOptions):
        return OsqpSolver(pattern, options)
    return DaqpSolver(pattern, options or DaqpOptions())

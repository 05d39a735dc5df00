"""The condensed program against a dense reference, its solver, and the real-time iteration around it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import LinearConstraint, minimize

from hystmpc.ctrl.command import CommandLimits, CommandPlan, Stopwatch
from hystmpc.ctrl.linearised.planner import LinearisedPlanner, TrackingQp
from hystmpc.ctrl.linearised.qp import OsqpOptions, OsqpSolver, QpData
from hystmpc.ctrl.mpc import PlanCost, PlanningError, PlanningProblem
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, WeightsSettings
from hystmpc.trials.errors import ConfigError, ControllerError

from .plays import DT, LINEAR, PLAY, SOUND, Case, Faulty, Lag, not_a_number

LIMITS = CommandLimits(0.0, 6.0, 4.0)
HARD = WeightsSettings(rate=1.0, effort=0.5)
SOFT = HARD.model_copy(update={"soft_limit": 50.0, "angle_lower_deg": 25.0, "angle_upper_deg": 42.0})
H = 5


def posed(case: Case, horizon: int = H, seed: int = 0) -> tuple[PlanningProblem, CommandPlan]:
    """A random problem and an admissible plan that starts it."""
    random = np.random.default_rng(seed)
    state, u_last = case.predictor.initial(40.0, 2.0), 2.0
    commands = LIMITS.clip_plans(u_last + np.cumsum(random.normal(0, 0.1, horizon)), u_last, DT)
    problem = PlanningProblem(
        state, u_last, 40.0 + np.cumsum(random.normal(0, 3.0, horizon)), commands - 0.05, SOFT.angle_limits_deg
    )
    return problem, CommandPlan(commands, case.predictor.rollout(state, commands[None])[0], math.inf)


def mpc(weights: WeightsSettings, horizon: int = 20, **changes: Any) -> LinearisedMpcSettings:
    return LinearisedMpcSettings(weights=weights, horizon=horizon, **changes)


def dense(data: QpData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hessian, gradient and rows of a program in its unknowns and the variables of its soft rows."""
    lower, soft = np.tril(data.hessian), data.soft > 0.0
    hessian = block_diag(lower + np.tril(lower, -1).T, np.diag(1.0 / data.soft[soft]))
    return (
        hessian,
        np.append(data.gradient, np.zeros(soft.sum())),
        np.hstack([data.columns.T, np.eye(soft.size)[:, soft]]),
    )


@pytest.mark.parametrize("weights", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("seed", range(5))
def test_solution_is_that_of_a_dense_reference(weights: WeightsSettings, case: Case, seed: int) -> None:
    problem, start = posed(case, seed=seed)
    qp = TrackingQp(weights, LIMITS, H, DT)
    data = qp.data(problem, start, case.predictor.linearise(problem.state, start.commands)[1])
    p, q, a = dense(data)
    solution = OsqpSolver(qp.pattern, OsqpOptions(eps=1e-8, iterations=20_000)).solve(data)
    reference = minimize(
        lambda z: 0.5 * z @ p @ z + q @ z,
        np.zeros(len(p)),
        jac=lambda z: p @ z + q,
        constraints=LinearConstraint(a, data.lower, data.upper),
        method="SLSQP",
        options={"ftol": 1e-13, "maxiter": 500},
    )
    assert solution.status == "solved"
    np.testing.assert_allclose(solution.primal[:H], reference.x[:H], atol=2e-5)


def test_program_is_the_planning_cost_where_the_model_is_linear() -> None:
    case = LINEAR
    problem, start = posed(case)
    cost = PlanCost(HARD, H)
    qp = TrackingQp(HARD, LIMITS, H, DT)
    data = qp.data(problem, start, case.predictor.linearise(problem.state, start.commands)[1])
    p, _, _ = dense(data)
    for v in np.random.default_rng(1).normal(0, 0.2, (10, H)):
        plans = np.array([start.commands, start.commands + v])
        costs = cost(plans, case.predictor.rollout(problem.state, plans), problem)
        assert costs[1] - costs[0] == pytest.approx(0.5 * v @ p @ v + data.gradient @ v, rel=1e-9)


@pytest.mark.parametrize("weights", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("iterations", [1, 2])
def test_result_is_admissible_and_never_worse_than_the_start(
    weights: WeightsSettings, case: Case, iterations: int
) -> None:
    horizon = 20
    planner = LinearisedPlanner(case.predictor, mpc(weights, iterations=iterations), LIMITS)
    cost = PlanCost(weights, horizon)
    for seed in range(20):
        problem, start = posed(case, horizon, seed)
        start = cost.best(start.commands[None], start.angles[None], problem)
        plan, _, _ = planner.improve(problem, start, planner.init(), Stopwatch())
        again = cost.best(plan.commands[None], case.predictor.rollout(problem.state, plan.commands[None]), problem)
        assert plan.cost <= start.cost
        assert plan.cost == pytest.approx(again.cost)
        np.testing.assert_allclose(LIMITS.clip_plans(plan.commands, problem.u_last, DT), plan.commands, atol=1e-12)


def test_one_iteration_is_optimal_where_the_model_is_linear() -> None:
    case, weights = LINEAR, HARD.model_copy(update={"effort": 0.0})
    problem, start = posed(case, 20)
    planner = LinearisedPlanner(case.predictor, mpc(weights), LIMITS, OsqpOptions(eps=1e-8, iterations=20_000))
    start = PlanCost(weights, 20).best(start.commands[None], start.angles[None], problem)
    once, _, _ = planner.improve(problem, start, planner.init(), Stopwatch())
    twice, _, _ = planner.improve(problem, once, planner.init(), Stopwatch())
    assert once.cost < 0.9 * start.cost
    assert twice.cost == pytest.approx(once.cost, rel=1e-6)


def test_equal_data_give_equal_answers_whatever_came_before() -> None:
    case = PLAY
    qp = TrackingQp(HARD, LIMITS, H, DT)
    solver = OsqpSolver(qp.pattern, OsqpOptions())
    data = []
    for seed in range(4):
        problem, start = posed(case, seed=seed)
        data.append(qp.data(problem, start, case.predictor.linearise(problem.state, start.commands)[1]))
    first = [solver.solve(d).primal for d in data]
    backwards = [solver.solve(d).primal for d in data[::-1]][::-1]
    np.testing.assert_array_equal(first, backwards)


def test_solver_that_failed_is_rebuilt() -> None:
    case = PLAY
    qp = TrackingQp(HARD, LIMITS, H, DT)
    solver = OsqpSolver(qp.pattern, OsqpOptions())
    problem, start = posed(case)
    data = qp.data(problem, start, case.predictor.linearise(problem.state, start.commands)[1])
    good = solver.solve(data)
    bad = solver.solve(replace(data, lower=data.lower + 10.0, upper=data.lower + 10.0))
    assert (bad.usable, bad.status) == (False, "primal infeasible")
    np.testing.assert_array_equal(solver.solve(data).primal, good.primal)


def test_rate_multipliers_are_exact_where_every_move_is_at_the_limit() -> None:
    problem, start = posed(LINEAR)
    ramp = problem.u_last + LIMITS.rate * DT * np.arange(1, H + 1)
    start = replace(start, commands=ramp, angles=Lag().rollout(problem.state, ramp[None])[0])
    problem = replace(problem, reference=np.full(H, 200.0), feedforward=ramp)
    qp = TrackingQp(HARD, LIMITS, H, DT)
    data = qp.data(problem, start, Lag().linearise(problem.state, ramp)[1])
    _, _, a = dense(data)
    np.testing.assert_allclose(a.T @ data.dual, -data.gradient, rtol=1e-9)
    assert OsqpSolver(qp.pattern, OsqpOptions()).solve(data).iterations <= 10


def test_jacobian_that_is_not_finite_is_a_planning_error() -> None:
    case = LINEAR
    problem, start = posed(case)
    planner = LinearisedPlanner(Faulty(case.predictor, not_a_number, -1.0), mpc(HARD, H), LIMITS)
    with pytest.raises(PlanningError, match="Jacobian is not finite"):
        planner.improve(problem, start, planner.init(), Stopwatch())


@pytest.mark.parametrize("change", [{"tracking": 0.0}, {"rate": 0.0}, {"effort": -1.0}])
def test_impossible_weights_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(change))):
        WeightsSettings.parse(change)


def test_angle_limits_that_cross_are_refused() -> None:
    with pytest.raises(ControllerError, match=r"weights: got angle_limits_deg 3\.0 to 2\.0"):
        TrackingQp(WeightsSettings(angle_lower_deg=3.0, angle_upper_deg=2.0), LIMITS, H, DT)

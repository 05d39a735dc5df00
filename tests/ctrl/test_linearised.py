"""The condensed program against a dense reference, its solver, and the real-time iteration around it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import LinearConstraint, minimize

from hystmpc.ctrl.law_tables import law_over
from hystmpc.ctrl.linearised.program import PlanProgram
from hystmpc.ctrl.linearised.qp import OsqpOptions, OsqpSolver, QpData
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, WeightsSettings
from hystmpc.trials.errors import ConfigError, ControllerError

from .planners import LIMITS, SOFT_DEG, Planner, posed
from .plays import DT, LINEAR, PLAY, SOUND, Case, Faulty, Lag, not_a_number

HARD = WeightsSettings(terminal=2.0, rate=1.0, effort=0.5)
SOFT = HARD.model_copy(
    update={"soft_limit": 50.0, "angle_lower_deg": SOFT_DEG[0], "angle_upper_deg": SOFT_DEG[1]},
)
H = 5


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
    program = PlanProgram(law_over(weights, H, LIMITS, DT))
    data = posed(case, H, seed).program(program, case.predictor)
    p, q, a = dense(data)
    solution = OsqpSolver(program.pattern, OsqpOptions(eps=1e-8, iterations=20_000)).solve(data)
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
    problem, predictor = posed(LINEAR, H), LINEAR.predictor
    data = problem.program(PlanProgram(law_over(HARD, H, LIMITS, DT)), predictor)
    p, _, _ = dense(data)
    before = problem.cost(HARD, problem.commands, problem.angles)
    for v in np.random.default_rng(1).normal(0, 0.2, (10, H)):
        moved = problem.at(predictor, problem.commands + v)
        change = problem.cost(HARD, moved.commands, moved.angles) - before
        assert change == pytest.approx(0.5 * v @ p @ v + data.gradient @ v, rel=1e-9)


@pytest.mark.parametrize("weights", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("iterations", [1, 2])
def test_result_is_admissible_and_never_worse_than_the_start(
    weights: WeightsSettings, case: Case, iterations: int
) -> None:
    planner = Planner(case, mpc(weights, iterations=iterations))
    for seed in range(20):
        problem = posed(case, 20, seed)
        plan = planner.improve(problem)
        again = problem.at(case.predictor, plan.commands)
        assert plan.answer == 0
        assert plan.cost <= problem.cost(weights, problem.commands, problem.angles)
        assert plan.cost == pytest.approx(problem.cost(weights, again.commands, again.angles))
        limited = LIMITS.clip_plans(plan.commands, problem.task.u_last, DT)
        np.testing.assert_allclose(limited, plan.commands, atol=1e-12)


@pytest.mark.parametrize("options", [None, OsqpOptions(eps=1e-8, iterations=20_000)], ids=["active set", "OSQP"])
def test_one_iteration_is_optimal_where_the_model_is_linear(options: OsqpOptions | None) -> None:
    weights = HARD.model_copy(update={"effort": 0.0})
    problem, planner = posed(LINEAR, 20), Planner(LINEAR, mpc(weights), options=options)
    once = planner.improve(problem)
    twice = planner.improve(problem.at(LINEAR.predictor, once.commands))
    assert once.cost < 0.9 * problem.cost(weights, problem.commands, problem.angles)
    assert twice.cost == pytest.approx(once.cost, rel=1e-6)


def test_equal_data_give_equal_answers_whatever_came_before() -> None:
    program = PlanProgram(law_over(HARD, H, LIMITS, DT))
    solver = OsqpSolver(program.pattern, OsqpOptions())
    data = [posed(PLAY, H, seed).program(program, PLAY.predictor) for seed in range(4)]
    first = [solver.solve(d).primal for d in data]
    backwards = [solver.solve(d).primal for d in data[::-1]][::-1]
    np.testing.assert_array_equal(first, backwards)


def test_solver_that_failed_is_rebuilt() -> None:
    program = PlanProgram(law_over(HARD, H, LIMITS, DT))
    solver, data = OsqpSolver(program.pattern, OsqpOptions()), posed(PLAY, H).program(program, PLAY.predictor)
    good = solver.solve(data)
    bad = solver.solve(replace(data, lower=data.lower + 10.0, upper=data.lower + 10.0))
    assert (bad.usable, bad.status) == (False, "primal infeasible")
    np.testing.assert_array_equal(solver.solve(data).primal, good.primal)


def test_rate_multipliers_are_exact_where_every_move_is_at_the_limit() -> None:
    problem = posed(LINEAR, H)
    ramp = problem.task.u_last + LIMITS.rate * DT * np.arange(1, H + 1)
    far = replace(problem, task=replace(problem.task, reference=np.full(H, 200.0), feedforward=ramp))
    program = PlanProgram(law_over(HARD, H, LIMITS, DT))
    data = far.at(Lag(), ramp).program(program, Lag())
    _, _, a = dense(data)
    np.testing.assert_allclose(a.T @ data.dual, -data.gradient, rtol=1e-9)
    assert OsqpSolver(program.pattern, OsqpOptions()).solve(data).iterations <= 10


@pytest.mark.parametrize("options", [None, OsqpOptions()], ids=["active set", "OSQP"])
def test_jacobian_that_is_not_finite_is_no_plan(options: OsqpOptions | None) -> None:
    planner = Planner(LINEAR, mpc(HARD, H), Faulty(LINEAR.predictor, not_a_number, -1.0), options)
    assert planner.improve(posed(LINEAR, H)).words == "the model's Jacobian is not finite"


@pytest.mark.parametrize("change", [{"tracking": 0.0}, {"rate": 0.0}, {"effort": -1.0}])
def test_impossible_weights_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(change))):
        WeightsSettings.parse(change)


def test_angle_limits_that_cross_are_refused() -> None:
    with pytest.raises(ControllerError, match=r"weights: got angle_limits_deg 3\.0 to 2\.0"):
        PlanProgram(law_over(WeightsSettings(angle_lower_deg=3.0, angle_upper_deg=2.0), H, LIMITS, DT))

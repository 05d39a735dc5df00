"""Blocked moves: the same program under an equality, within all limits, and no worse at tracking."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space

from hystmpc.ctrl.law_tables import MoveBlocking, law_over
from hystmpc.ctrl.linearised.program import PlanProgram
from hystmpc.ctrl.linearised.qp import OsqpOptions, OsqpSolver, QpData, QpPattern, QpSolution
from hystmpc.ctrl.mpc_settings import WeightsSettings
from hystmpc.trials.errors import ControllerError

from .planners import LIMITS, Planner, exact, posed
from .plays import DT, LINEAR, SOUND, Case
from .test_linearised import HARD, SOFT, dense, mpc
from .test_solvers import TIGHT
from .test_tracking import built, resting, scan, track

H = 12
BLOCKS = [(1, 1, 2, 8), (3, 4, 5), (2, 3), (12,), (1,)]
REACH = LIMITS.rate * DT

lengths = st.lists(st.integers(1, 6), min_size=1, max_size=6).map(tuple)


def blocked(weights: WeightsSettings, blocks: tuple[int, ...], horizon: int = H) -> PlanProgram:
    return PlanProgram(law_over(weights, horizon, LIMITS, DT, blocks))


def data_of(program: PlanProgram, case: Case, seed: int, horizon: int = H) -> QpData:
    return posed(case, horizon, seed).program(program, case.predictor)


def under_equality(full: PlanProgram, data: QpData, matrix: np.ndarray) -> QpSolution:
    """The full program with rows that hold v in the range of M."""
    equal = null_space(matrix.T)
    none = np.zeros(equal.shape[1])
    pattern = QpPattern(
        np.hstack([full.pattern.nonzero, np.ones(equal.shape, dtype=bool)]), np.append(full.pattern.soft, none > 0.0)
    )
    more = replace(
        data,
        columns=np.hstack([data.columns, equal]),
        **{name: np.append(getattr(data, name), none) for name in ("lower", "upper", "soft", "dual")},
    )
    return OsqpSolver(pattern, TIGHT).solve(more)


@given(lengths, st.integers(0, 5), st.integers(0, 1000))
def test_moves_are_even_within_a_block_and_zero_after_the_last(blocks: tuple[int, ...], left: int, seed: int) -> None:
    blocking = MoveBlocking(blocks, sum(blocks) + left)
    w = np.random.default_rng(seed).normal(size=len(blocks))
    v = blocking.matrix @ w
    np.testing.assert_allclose(v[blocking.ends], w, atol=1e-12)
    moves = np.diff(v, prepend=0.0)
    even = np.repeat(np.diff(w, prepend=0.0) / np.array(blocks), blocks)
    np.testing.assert_allclose(moves, np.concatenate([even, np.zeros(left)]), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("blocks", BLOCKS, ids=str)
@pytest.mark.parametrize("weights", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
def test_it_is_the_full_program_under_an_equality(
    case: Case, weights: WeightsSettings, blocks: tuple[int, ...]
) -> None:
    few_moves, full = blocked(weights, blocks), PlanProgram(law_over(weights, H, LIMITS, DT))
    for seed in range(5):
        few = exact(data_of(few_moves, case, seed))
        many = under_equality(full, data_of(full, case, seed), MoveBlocking(blocks, H).matrix)
        assert few.status == "solved"
        assert many.status in ("solved", "solved inaccurate")  # within ten times 1e-9
        np.testing.assert_allclose(few_moves.deviation(few.primal), many.primal[:H], atol=2e-6)


@pytest.mark.parametrize("weights", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
def test_blocks_of_one_sample_are_no_blocks(case: Case, weights: WeightsSettings) -> None:
    programs = blocked(weights, (1,) * H), PlanProgram(law_over(weights, H, LIMITS, DT))
    for seed in range(5):
        ours, theirs = (p.deviation(exact(data_of(p, case, seed)).primal) for p in programs)
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("blocks", BLOCKS, ids=str)
def test_program_is_the_planning_cost_where_the_model_is_linear(blocks: tuple[int, ...]) -> None:
    problem, program = posed(LINEAR, H), blocked(HARD, blocks)
    data = problem.program(program, LINEAR.predictor)
    p, _, _ = dense(data)
    before = problem.cost(HARD, problem.commands, problem.angles)
    for w in np.random.default_rng(1).normal(0, 0.2, (10, len(blocks))):
        moved = problem.at(LINEAR.predictor, problem.commands + program.deviation(w))
        change = problem.cost(HARD, moved.commands, moved.angles) - before
        assert change == pytest.approx(0.5 * w @ p @ w + data.gradient @ w, rel=1e-9)


@given(lengths, st.integers(0, 5), st.integers(0, 10_000), st.sampled_from(SOUND))
@settings(deadline=None)
def test_every_sample_is_within_the_limits(blocks: tuple[int, ...], left: int, seed: int, case: Case) -> None:
    horizon = sum(blocks) + left
    program, problem = blocked(HARD, blocks, horizon), posed(case, horizon, seed)
    solution = exact(problem.program(program, case.predictor))
    assert solution.usable
    plan = problem.commands + program.deviation(solution.primal)
    assert np.all((plan >= LIMITS.lower - 1e-6) & (plan <= LIMITS.upper + 1e-6))
    assert np.max(np.abs(np.diff(plan, prepend=problem.task.u_last))) <= REACH + 1e-6


def test_a_far_reference_is_approached_at_the_greatest_rate_across_block_edges() -> None:
    problem = posed(LINEAR, H)
    rest = np.full(H, problem.task.u_last)
    far = replace(problem, task=replace(problem.task, reference=np.full(H, 500.0), feedforward=rest))
    program = blocked(HARD, (1, 3, 8))
    solution = exact(far.at(LINEAR.predictor, rest).program(program, LINEAR.predictor))
    np.testing.assert_allclose(program.deviation(solution.primal), REACH * np.arange(1, H + 1), atol=1e-6)


@pytest.mark.parametrize("solver", ["active set", "OSQP"])
def test_a_block_in_which_the_plan_moves_both_ways_at_the_limit_stays_as_it_is(solver: str) -> None:
    problem = posed(LINEAR, 4)
    there = problem.at(LINEAR.predictor, problem.task.u_last + REACH * np.array([1.0, 0.0, 1.0, 1.0]))
    program = blocked(HARD, (2, 2), 4)
    data = there.program(program, LINEAR.predictor)
    solution = exact(data) if solver == "active set" else OsqpSolver(program.pattern, OsqpOptions()).solve(data)
    assert solution.usable
    np.testing.assert_allclose(program.deviation(solution.primal)[:2], 0.0, atol=1e-4)


@pytest.mark.parametrize("weights", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
def test_result_is_admissible_and_never_worse_than_the_start(weights: WeightsSettings, case: Case) -> None:
    planner, better = Planner(case, mpc(weights, move_blocking=(1, 2, 4, 6))), 0
    for seed in range(20):
        problem = posed(case, 20, seed)
        plan, start = planner.improve(problem), problem.cost(weights, problem.commands, problem.angles)
        assert plan.cost <= start
        better += plan.cost < 0.95 * start
        limited = LIMITS.clip_plans(plan.commands, problem.task.u_last, DT)
        np.testing.assert_allclose(limited, plan.commands, atol=1e-12)
    assert better > 10


@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
def test_a_scan_is_followed_as_closely_with_five_decisions_as_with_twenty(case: Case) -> None:
    errors = []
    for blocks in (None, [1, 1, 2, 4, 8]):
        controller = built("linearised_mpc", case, move_blocking=blocks)
        _, error = track(controller, resting(case, noise_deg=0.1), scan, 8.0)
        errors.append(float(np.sqrt(np.mean(error[50:] ** 2))))
    assert errors[1] < 1.1 * errors[0] + 0.001


@pytest.mark.parametrize("blocks", [(), (0, 2), (5, 8)])
def test_blocks_that_do_not_fit_are_refused(blocks: tuple[int, ...]) -> None:
    with pytest.raises(ControllerError, match="move_blocking: got blocks"):
        MoveBlocking(blocks, H)

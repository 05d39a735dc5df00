"""Laws of the engine's planners, each over a straight model and one with a play that are written in Python."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, minimize

from hystmpc.core.library import engine
from hystmpc.core.structs import Struct, constants, layout, struct

H, SAMPLES = 8, 40
LOWER, UPPER, REACH = 0.0, 6.0, 0.5
TRACKING = np.append(np.ones(H - 1), 3.0)
RATE, EFFORT, SOFT = 3.0, 0.01, 100.0
BLOCKS = (1, 1, 2, 4)
NO_JACOBIAN, NO_SAMPLE, NO_ANSWER = -5, -7, -9
GUARD, MARK = 4096, 171  # bytes behind a room, and what they hold


def straight(state: np.ndarray, plan: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A lag, y+ = 0.6 y + 0.4 (10 u + 20): angles (H,) and their derivatives (H, H)."""
    ages = np.arange(plan.size)[:, None] - np.arange(plan.size)
    jacobian = np.where(ages >= 0, 4.0 * 0.6 ** np.maximum(ages, 0), 0.0)
    return state[0] * 0.6 ** np.arange(1, plan.size + 1) + jacobian @ (plan + 2.0), jacobian


def play(state: np.ndarray, plan: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A play of half width 0.4, y = max(10 (u - 0.4), min(10 (u + 0.4), y))."""
    angles, jacobian, y, row = np.empty(plan.size), np.zeros((plan.size, plan.size)), float(state[0]), None
    for k, u in enumerate(plan):
        moved = max(10.0 * (u - 0.4), min(10.0 * (u + 0.4), y))
        row, y = (k if moved != y else row), moved
        angles[k] = y
        if row is not None:
            jacobian[k, row] = 10.0
    return angles, jacobian


MODELS = {"straight": straight, "play": play}
Model = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def view(address: int, *shape: int) -> np.ndarray:
    return np.ctypeslib.as_array((ctypes.c_double * math.prod(shape)).from_address(address)).reshape(shape)


@cache
def model_of(model: Model) -> Struct:
    """The engine's model of one number of state; one whose function raises has failed."""

    @contextmanager
    def answer(failed: list[int]) -> Iterator[None]:
        try:
            yield
        except ArithmeticError:
            failed.append(1)

    def run(x: int, rows: int, samples: int, plans: int, angles: int) -> int:
        failed: list[int] = []
        with answer(failed):
            for plan, row in zip(view(plans, rows, samples), view(angles, rows, samples), strict=True):
                row[:] = model(view(x, 1), plan)[0]
        return len(failed)

    def linearise(x: int, samples: int, plan: int, angles: int, jacobian: int) -> int:
        failed: list[int] = []
        with answer(failed):
            view(angles, samples)[:], view(jacobian, samples, samples)[:] = model(view(x, 1), view(plan, samples))
        return len(failed)

    outside = struct("hystmpc_outside", run=run, linearise=linearise)
    predictor = struct("hystmpc_predictor", kind=constants()["HYSTMPC_WRITTEN"], states=1, outside=outside)
    return struct("hystmpc_model", predictor=predictor)


def blocking() -> np.ndarray:
    """Deviations (H, m) of the samples by those at the ends of the blocks, which are straight in between."""
    ends = np.cumsum(BLOCKS)
    return np.array([np.interp(np.arange(1, H + 1), [0, *ends], [0.0, *unit]) for unit in np.eye(ends.size)]).T


def law_of(soft: bool, blocked: bool) -> Struct:
    ends = np.cumsum(BLOCKS) - 1 if blocked else np.arange(H)
    tables = {}
    if blocked:
        tables = {"blocking": blocking()}
    return struct(
        "hystmpc_law",
        horizon=H,
        moves=ends.size,
        blocked=blocked,
        soft=soft,
        lower=LOWER,
        upper=UPPER,
        reach=REACH,
        effort_weight=EFFORT,
        soft_weight=SOFT if soft else 0.0,
        tracking=TRACKING,
        starts=ends - (np.array(BLOCKS) - 1 if blocked else 0),
        ends=ends,
        **tables,
    )


def damped(reference: int, _: int, scalars: int, jacobian: int, commands: int, angles: int, out: int) -> int:
    """Solution of a program in Python, which is not quite finished: a damped Gauss-Newton step within the limits."""
    if not np.all(np.isfinite(view(jacobian, H, H))):
        return NO_JACOBIAN
    missed = np.append(view(reference, H) - view(angles, H), np.zeros(H))
    wanted = view(commands, H) + np.linalg.lstsq(np.vstack([view(jacobian, H, H), np.eye(H)]), missed)[0]
    plan, last = view(out, H + 1), view(scalars, 4)[0]
    for k in range(H):
        plan[k] = last = np.clip(wanted[k], max(LOWER, last - REACH), min(UPPER, last + REACH))
    plan[H] = 0.0
    return 1


def sampling_of(soft: bool, blocked: bool) -> Struct:
    factor = np.diag(np.linspace(1.0, 0.5, len(BLOCKS) if blocked else H))
    return struct(
        "hystmpc_sampling",
        samples=SAMPLES,
        size=len(factor),
        elites=6,
        kept=2,
        seed=[11, 7],
        temperature=0.02,
        sigma=REACH,
        least_sigma=0.01 * REACH,
        sigmas=REACH * np.geomspace(1.0, 0.01, SAMPLES),
        shape=((blocking() if blocked else np.eye(H)) @ factor).T,
        whitening=np.linalg.inv(factor).T,
        fitted=law_of(soft, blocked),
    )


@cache
def planner_of(kind: str, soft: bool = False, blocked: bool = False, iterations: int = 1) -> Struct:
    number, random = constants()[f"HYSTMPC_{kind}"], kind in RANDOM
    return struct(
        "hystmpc_planner",
        kind=number,
        iterations=iterations,
        changes=1000,
        law=law_of(soft, blocked and not random),
        sampling=sampling_of(soft, blocked) if random else None,
        solve=damped if kind == "SOLVED" else None,
    )


RANDOM = ("PATH_INTEGRAL", "CROSS_ENTROPY")
PLANNERS = {
    f"{kind} {'soft ' if soft else ''}{'blocked' if blocked else ''}": (kind, soft, blocked)
    for kind in ("LINEARISED", "SOLVED", *RANDOM)
    for soft in (False, True)
    for blocked in (False, True)
}


@dataclass(frozen=True, eq=False)
class Problem:
    """A planning problem and an admissible plan to begin with."""

    model: Model
    state: np.ndarray
    u_last: float
    reference: np.ndarray
    start: np.ndarray
    limits: tuple[float, float] = (-math.inf, math.inf)

    def cost(self, plan: np.ndarray, soft: bool = False) -> float:
        angles = self.model(self.state, plan)[0]
        moves, off = np.diff(plan, prepend=self.u_last), plan - self.start
        excess = np.maximum(angles - self.limits[1], 0.0) + np.maximum(self.limits[0] - angles, 0.0)
        terms = TRACKING * (angles - self.reference) ** 2 + RATE * moves**2 + EFFORT * off**2
        return float(np.sum(terms + SOFT * excess**2 * soft))


def posed(model: Model, seed: int, u: float | None = None) -> Problem:
    random = np.random.default_rng(seed)
    u = random.uniform(LOWER, UPPER) if u is None else u
    start, last = np.empty(H), u
    for k in range(H):
        start[k] = last = np.clip(last + random.normal(0.0, 0.2), max(LOWER, last - REACH), min(UPPER, last + REACH))
    state = np.array([model(np.array([10.0 * u]), np.full(30, u))[0][-1]])
    reference = state[0] + np.cumsum(random.normal(0.0, 3.0, H))
    return Problem(model, state, float(u), reference, start, (state[0] - 5.0, state[0] + 5.0))


@dataclass(frozen=True, eq=False)
class Answer:
    """What `hystmpc_improve` answers, the plan with its angles and cost, and the steps counted."""

    answer: int
    plan: np.ndarray
    angles: np.ndarray
    cost: float
    draws: int


def improve(planner: Struct, problem: Problem, draws: int = 3, soft: bool = False, **changes: Any) -> Answer:
    task = struct(
        "hystmpc_task",
        reference=problem.reference,
        feedforward=problem.start,
        u_last=changes.get("u_last", problem.u_last),
        rate_weight=RATE,
        low=problem.limits[0],
        high=problem.limits[1],
    )
    model, count = changes.get("engine_model") or model_of(problem.model), ctypes.c_int64(draws)
    size = engine().planner_bytes(planner.address, model.address)
    room = np.full(size + GUARD, MARK, dtype=np.uint8)
    plan, angles = problem.start.copy(), problem.model(problem.state, problem.start)[0]
    best = layout("hystmpc_plan")(plan.ctypes.data, angles.ctypes.data, problem.cost(plan, soft))
    state = changes.get("state", problem.state)
    given = planner.address, model.address, state, task.address, ctypes.addressof(best), ctypes.addressof(count), room
    answer = engine().improve(*given)
    assert np.all(room[size:] == MARK)
    return Answer(answer, plan, angles, best.cost, count.value)


every_planner = pytest.mark.parametrize("name", PLANNERS)
every_planner_in_c = pytest.mark.parametrize("name", [name for name in PLANNERS if "SOLVED" not in name])
every_model = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


@every_model
@every_planner
@settings(max_examples=8)
@given(seed=st.integers(0, 10**6), iterations=st.integers(1, 3))
def test_a_plan_is_admissible_and_never_costs_more_than_the_start(
    name: str, model: Model, seed: int, iterations: int
) -> None:
    kind, soft, blocked = PLANNERS[name]
    problem = posed(model, seed)
    result = improve(planner_of(kind, soft, blocked, iterations), problem, soft=soft)
    assert result.answer == (kind == "SOLVED")
    assert result.cost <= problem.cost(problem.start, soft)
    assert result.cost == pytest.approx(problem.cost(result.plan, soft), rel=1e-12)
    np.testing.assert_array_equal(result.angles, model(problem.state, result.plan)[0])
    assert np.all((result.plan >= LOWER) & (result.plan <= UPPER))
    assert np.all(np.abs(np.diff(result.plan, prepend=problem.u_last)) <= REACH + 1e-12)
    assert result.draws == 3 + (kind in RANDOM)


@every_planner
def test_equal_problems_and_draws_give_equal_plans(name: str) -> None:
    kind, soft, blocked = PLANNERS[name]
    planner, problem = planner_of(kind, soft, blocked), posed(play, 4)
    first, again, other = (improve(planner, problem, draws, soft) for draws in (3, 3, 4))
    np.testing.assert_array_equal(first.plan, again.plan)
    assert first.cost == again.cost
    assert np.array_equal(first.plan, other.plan) == (kind not in RANDOM)


def optimum(problem: Problem, soft: bool = False) -> float:
    """Least cost of an admissible plan of a straight model."""
    difference = np.eye(H) - np.eye(H, k=-1)
    first = problem.u_last * np.eye(H)[0]
    limits = [
        LinearConstraint(np.eye(H), LOWER, UPPER),
        LinearConstraint(difference, first - REACH, first + REACH),
    ]
    options = {"ftol": 1e-13, "maxiter": 500}
    return float(
        minimize(problem.cost, problem.start, (soft,), constraints=limits, method="SLSQP", options=options).fun
    )


@pytest.mark.parametrize("seed", range(4))
def test_one_step_finds_the_optimum_of_a_straight_model(seed: int) -> None:
    problem = posed(straight, seed)
    best, start = optimum(problem), problem.cost(problem.start)
    assert improve(planner_of("LINEARISED"), problem).cost == pytest.approx(best, rel=1e-6)
    for kind in RANDOM:  # the fitted slope is that of the model, but for the ridge
        assert improve(planner_of(kind), problem).cost <= best + 1e-3 * (start - best)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("end", [LOWER, UPPER])
def test_the_optimum_is_found_where_only_the_last_command_binds(seed: int, end: float) -> None:
    """Slowly beyond the range: without it every move would be within the rate."""
    inwards = math.copysign(0.2, 3.0 - end)
    problem = posed(straight, seed, end + inwards)
    problem = replace(problem, reference=problem.state[0] - inwards * np.linspace(0.0, 30.0, H))
    assert improve(planner_of("LINEARISED"), problem).cost == pytest.approx(optimum(problem), rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_the_optimum_is_found_where_only_a_soft_limit_binds(seed: int) -> None:
    problem = posed(straight, seed, 3.0)
    problem = replace(
        problem,
        reference=problem.state[0] + np.linspace(0.0, 4.0, H),
        limits=(-math.inf, problem.state[0] + 1.0),
    )
    found = improve(planner_of("LINEARISED", soft=True), problem, soft=True)
    assert found.cost == pytest.approx(optimum(problem, True), rel=1e-4)
    assert found.cost < problem.cost(improve(planner_of("LINEARISED"), problem).plan, True)


@every_planner
def test_more_iterations_do_not_cost_more(name: str) -> None:
    kind, soft, blocked = PLANNERS[name]
    problem = posed(play, 9)
    costs = [improve(planner_of(kind, soft, blocked, n), problem, soft=soft).cost for n in (1, 2, 4)]
    assert costs == sorted(costs, reverse=True)


def not_a_number(state: np.ndarray, plan: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.full(plan.size, np.nan), np.full((plan.size, plan.size), np.nan)


def failing(state: np.ndarray, plan: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    raise ZeroDivisionError


@every_planner
def test_a_model_that_fails_leaves_plan_and_draws_as_they_were(name: str) -> None:
    kind, soft, blocked = PLANNERS[name]
    problem = posed(straight, 1)
    for model, answer in ((failing, NO_ANSWER), (not_a_number, NO_SAMPLE if kind in RANDOM else NO_JACOBIAN)):
        result = improve(planner_of(kind, soft, blocked), problem, engine_model=model_of(model), soft=soft)
        assert (result.answer, result.draws) == (answer, 3)
        np.testing.assert_array_equal(result.plan, problem.start)


@every_model
@every_planner_in_c
@settings(max_examples=6)
@given(
    value=st.sampled_from([math.nan, math.inf, -math.inf, 1e300, 5e-324]), where=st.sampled_from(["u_last", "state"])
)
def test_hostile_numbers_are_survived(name: str, model: Model, value: float, where: str) -> None:
    kind, soft, blocked = PLANNERS[name]
    problem = posed(model, 2)
    hostile = value if where == "u_last" else np.array([value])
    with np.errstate(all="ignore"):
        result = improve(planner_of(kind, soft, blocked), problem, soft=soft, **{where: hostile})
    assert result.answer <= 0
    assert result.cost <= problem.cost(problem.start, soft)

"""Laws of both sampling planners and their noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hystmpc.core.library import engine
from hystmpc.ctrl.linearised.qp import OsqpOptions
from hystmpc.ctrl.mpc_settings import (
    ColouredNoiseSettings,
    LinearisedMpcSettings,
    SamplingMpcSettings,
    SplineNoiseSettings,
    WeightsSettings,
)
from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ConfigError, ControllerError

from .planners import LIMITS, Planner, Problem, posed
from .plays import DT, LINEAR, PLAY, SOUND, Case, Faulty, not_a_number
from .test_tracking import built, resting, scan, track

H = 20
WEIGHTS = WeightsSettings()
NOISES: dict[str, SplineNoiseSettings | ColouredNoiseSettings] = {
    "spline": SplineNoiseSettings(),
    "red": ColouredNoiseSettings(exponent=2.0),
    "white": ColouredNoiseSettings(exponent=0.0),
}
METHODS: tuple[Any, ...] = ("mppi", "cem")


def planner_for(case: Case, noise: str = "spline", predictor: Predictor | None = None, **options: Any) -> Planner:
    settings = SamplingMpcSettings(weights=WEIGHTS, horizon=H, noise=NOISES[noise], **options)
    return Planner(case, settings, predictor)


def cost_before(problem: Problem) -> float:
    return problem.cost(WEIGHTS, problem.commands, problem.angles)


@pytest.mark.parametrize("name", NOISES)
def test_every_sample_is_perturbed_with_the_same_variance(name: str) -> None:
    np.testing.assert_allclose(np.sum(NOISES[name].matrix(H) ** 2, axis=1), 1.0)


def test_white_noise_is_white_and_red_noise_is_smooth() -> None:
    shapes = {name: noise.matrix(H) for name, noise in NOISES.items()}
    covariance = shapes["white"] @ shapes["white"].T
    assert np.max(np.abs(covariance - np.eye(H))) < 0.06
    neighbours = {name: np.mean(np.diag(noise @ noise.T, 1)) for name, noise in shapes.items()}
    assert neighbours["red"] > 0.8
    assert neighbours["spline"] > 0.8


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
def test_result_is_admissible_and_never_worse_than_the_start(case: Case, noise: str, method: str) -> None:
    planner = planner_for(case, noise, method=method, samples=64)
    better = 0
    for seed in range(10):
        problem = posed(case, H, seed)
        plan, start = planner.improve(problem), cost_before(problem)
        better += plan.cost < start
        assert plan.answer == 0
        assert plan.cost <= start
        limited = LIMITS.clip_plans(plan.commands, problem.task.u_last, DT)
        np.testing.assert_allclose(limited, plan.commands, atol=1e-12)
    assert better == 10  # a random start is far from the optimum


@pytest.mark.parametrize("method", METHODS)
def test_random_numbers_depend_on_seed_and_step_alone(method: str) -> None:
    problem, planner = posed(PLAY, H), planner_for(PLAY, method=method, samples=32)
    first = planner.improve(problem, 7)
    assert first.draws == 8
    planner.improve(problem, first.draws)
    again = planner_for(PLAY, method=method, samples=32).improve(problem, 7)
    np.testing.assert_array_equal(first.commands, again.commands)
    for other, draws in ((planner_for(PLAY, method=method, samples=32, seed=1), 7), (planner, 8)):
        assert not np.array_equal(first.commands, other.improve(problem, draws).commands)


@pytest.mark.parametrize("method", METHODS)
def test_many_iterations_find_the_optimum_of_a_linear_model(method: str) -> None:
    problem = posed(LINEAR, H, 1)
    settings = LinearisedMpcSettings(weights=WEIGHTS, horizon=H, iterations=3)
    optimum = Planner(LINEAR, settings, options=OsqpOptions(eps=1e-8, iterations=20_000)).improve(problem)
    plan = planner_for(LINEAR, "red", method=method, iterations=40).improve(problem)
    assert plan.cost <= optimum.cost + 0.05 * (cost_before(problem) - optimum.cost)


@pytest.mark.parametrize("horizon", [20, 60])
@pytest.mark.parametrize("seed", range(5))
def test_one_iteration_finds_the_optimum_in_blocked_moves_of_a_linear_model(horizon: int, seed: int) -> None:
    ours = SamplingMpcSettings(weights=WEIGHTS, horizon=horizon, seed=seed)
    settings = LinearisedMpcSettings(weights=WEIGHTS, horizon=horizon, move_blocking=ours.blocks(DT))
    problem = posed(LINEAR, horizon, seed)
    optimum, plan = Planner(LINEAR, settings).improve(problem), Planner(LINEAR, ours).improve(problem)
    assert plan.cost <= optimum.cost + 0.05 * (cost_before(problem) - optimum.cost)
    limited = LIMITS.clip_plans(plan.commands, problem.task.u_last, DT)
    np.testing.assert_allclose(limited, plan.commands, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
def test_a_scan_with_a_long_preview_is_followed_as_closely_as_by_the_linearised_controller(case: Case) -> None:
    errors = []
    blocks = SamplingMpcSettings(horizon=60).blocks(DT)
    for kind, options in (("linearised_mpc", {"move_blocking": blocks}), ("sampling_mpc", {})):
        controller = built(kind, case, horizon=60, **options)
        _, error = track(controller, resting(case, noise_deg=0.1), scan, 8.0)
        errors.append(float(np.sqrt(np.mean(error[50:] ** 2))))
    assert errors[1] < 1.1 * errors[0]


def test_a_long_preview_has_the_blocks_of_the_linearised_controller_and_a_short_one_has_none() -> None:
    sampling, linearised = SamplingMpcSettings(), LinearisedMpcSettings()
    assert sampling.blocks(0.004) == linearised.blocks(0.004)
    assert sampling.blocks(0.04) == (1,) * 20


@pytest.mark.parametrize("count", [3, 7, 16])
def test_samples_show_every_direction_once_before_any_other(count: int) -> None:
    drawn = np.random.default_rng(0).standard_normal((count, 7))
    made = drawn.copy()
    engine().make_orthogonal(count, 7, made, np.empty(count))
    np.testing.assert_allclose(np.linalg.norm(made, axis=1), np.linalg.norm(drawn, axis=1))
    for first in range(0, count, 7):
        products = made[first : first + 7] @ made[first : first + 7].T
        np.testing.assert_allclose(products, np.diag(np.diag(products)), atol=1e-9)


def test_the_slope_of_a_linear_model_is_found_from_one_sample_a_direction() -> None:
    random = np.random.default_rng(1)
    slope, start, around = random.standard_normal((9, 4)), random.standard_normal(9), random.standard_normal(9)
    ends, factor = np.array([1, 3, 4, 8], dtype=np.intc), random.standard_normal((4, 4))
    plans, found = random.standard_normal((4, 9)), np.empty((9, 4))
    plans[:, ends] = start[ends] + factor.T  # z is a unit vector each time
    angles = around + (plans - start)[:, ends] @ slope.T
    whitening = np.ascontiguousarray(np.linalg.inv(factor).T)
    engine().fit_columns(4, 9, 4, plans, angles, start, around, ends, whitening, np.empty(5 * 13), found)
    np.testing.assert_allclose(found, slope, atol=1e-4)


def test_perturbations_follow_the_rate_limit_unless_they_are_given() -> None:
    assert SamplingMpcSettings().deviation(0.1) == pytest.approx(0.01)
    assert SamplingMpcSettings(sigma=0.3).deviation(0.1) == 0.3


@pytest.mark.parametrize("method", METHODS)
def test_predictions_that_are_not_finite_are_no_plan(method: str) -> None:
    planner = planner_for(PLAY, predictor=Faulty(PLAY.predictor, not_a_number, -1.0), method=method)
    assert planner.improve(posed(PLAY, H)).words == "no random plan has a finite prediction"


@pytest.mark.parametrize(
    "change", [{"samples": 0}, {"sigma": -1.0}, {"finest": 2.0}, {"seed": -1}, {"elites": 0.6}, {"temperature": 0.0}]
)
def test_impossible_options_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(change))):
        SamplingMpcSettings.parse(change)


def test_impossible_noise_is_refused() -> None:
    with pytest.raises(ControllerError, match="expected 2 to the horizon of 20"):
        SplineNoiseSettings(knots=21).matrix(20)
    with pytest.raises(ConfigError, match="exponent"):
        ColouredNoiseSettings.parse({"exponent": -1.0})

"""Laws of the learned part: it is nothing at first, exact in its derivatives, and finds what the model leaves over."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.estimation.learning import LearnedInverse, LearnedPredictor, LearningEstimator
from hystmpc.ctrl.estimation.observer import EstimatorSettings
from hystmpc.ctrl.limits import CommandLimits
from hystmpc.ctrl.planning_settings import AdaptationSettings
from hystmpc.trials.errors import ConfigError

from .plays import DT, SOUND, Backlash

LIMITS = CommandLimits(0.0, 6.0, 10.0)
RNG = np.random.default_rng(3)
OPTIONS = EstimatorSettings(drift_sigma_deg_per_sqrt_s=0.05, dead_band_gain_deg_per_unit=0.0)


def learned(lag_s: float = 0.08) -> LearnedPredictor:
    return LearnedPredictor(Backlash(), AdaptationSettings(plays=3, widest_share=0.2, lag_s=lag_s))


def moved(predictor: LearnedPredictor, weights: np.ndarray, seed: int = 0) -> np.ndarray:
    """A state with a past, under some weights."""
    state = predictor.with_weights(predictor.initial(30.0, 1.0), weights)
    for u in 1.0 + np.cumsum(np.random.default_rng(seed).normal(0.0, 0.15, 40)):
        _, state = predictor.advance(state, float(np.clip(u, 0.0, 6.0)))
    return state


def plans(count: int, horizon: int) -> np.ndarray:
    return np.clip(1.0 + np.cumsum(RNG.normal(0.0, 0.2, (count, horizon)), axis=1), 0.0, 6.0)


@pytest.mark.parametrize("lag_s", [0.0, 0.08])
def test_without_weights_it_is_the_model(lag_s: float) -> None:
    predictor = learned(lag_s)
    state, trial = moved(predictor, np.zeros(predictor.size)), plans(4, 12)
    below = predictor.below(state)
    np.testing.assert_array_equal(predictor.rollout(state, trial), Backlash().rollout(below, trial))
    np.testing.assert_array_equal(predictor.linearise(state, trial[0])[1], Backlash().linearise(below, trial[0])[1])


def test_what_is_learned_is_the_whole_less_the_model() -> None:
    predictor = learned()
    state, trial = moved(predictor, np.array([1.0, -0.5, 2.0, 0.7, 0.03])), plans(4, 12)
    model = predictor.model.rollout(predictor.below(state), trial)
    np.testing.assert_array_equal(predictor.learned(state, trial), predictor.rollout(state, trial) - model)
    assert np.ptp(predictor.learned(state, trial)) > 0.1


@given(st.lists(st.floats(-3, 3), min_size=5, max_size=5), st.integers(0, 100))
def test_a_roll_out_is_its_single_steps(weights: list[float], seed: int) -> None:
    predictor = learned()
    start, plan = moved(predictor, np.array(weights), seed), plans(1, 15)
    state, single = start, []
    for u in plan[0]:
        angle, state = predictor.advance(state, float(u))
        single.append(angle)
    np.testing.assert_allclose(predictor.rollout(start, plan)[0], single, atol=1e-10)
    np.testing.assert_allclose(predictor.linearise(start, plan[0])[0], single, atol=1e-10)


def test_the_jacobian_is_the_difference_quotient() -> None:
    predictor, step = learned(), 1e-6
    state, plan = moved(predictor, np.array([1.0, -0.5, 2.0, 0.7, 0.03])), plans(1, 12)[0]
    _, jacobian = predictor.linearise(state, plan)
    both = predictor.rollout(state, np.concatenate([plan + step * np.eye(12), plan - step * np.eye(12)]))
    np.testing.assert_allclose(jacobian, ((both[:12] - both[12:]) / (2 * step)).T, atol=1e-4)


def test_it_finds_a_wider_loop_and_another_slope() -> None:
    """A recording of other plays and slope: after one flexure the learned model foretells the next one."""
    truth, predictor = learned(0.0), learned(0.0)
    weights = np.array([0.8, 0.5, -0.9, 0.6, 0.0])
    device = truth.with_weights(truth.initial(30.0, 0.0), weights)
    estimator = LearningEstimator(predictor, OPTIONS, AdaptationSettings())
    flexure = 3.0 - 3.0 * np.cos(np.linspace(0.0, 4.0 * math.pi, 250))
    noise, y = np.random.default_rng(1), predictor.advance(device, 0.0)[0]
    estimate, errors, plain = estimator.init(y, 0.0), [], []
    state, offset = predictor.initial(y, 0.0), y - Backlash().advance(Backlash().initial(y, 0.0), 0.0)[0]
    for u in flexure:
        estimate = estimator.correct(estimate, y + 0.05 * noise.standard_normal())
        estimate = estimator.advance(estimate, float(u))
        y, device = truth.advance(device, float(u))
        angle, state = predictor.advance(state, float(u))
        errors.append(estimate.angles[-1] + estimate.disturbance - y)
        plain.append(angle + offset - y)
    late = slice(125, None)
    assert np.sqrt(np.mean(np.square(errors[late]))) < 0.1
    assert np.sqrt(np.mean(np.square(plain[late]))) > 0.5
    assert np.all(np.linalg.eigvalsh(estimate.covariance) > -1e-9)


def test_in_a_hold_nothing_is_forgotten() -> None:
    estimator = LearningEstimator(learned(), OPTIONS, AdaptationSettings())
    estimate = estimator.init(30.0, 1.0)
    before = estimate.covariance[1:, 1:]
    for _ in range(200):
        estimate = estimator.advance(estimator.correct(estimate, 30.0), 1.0)
    np.testing.assert_allclose(estimate.covariance[1:, 1:], before, atol=1e-9)


@pytest.mark.parametrize("y", [math.nan, math.inf, 1e9])
def test_nonsense_is_missing(y: float) -> None:
    estimator = LearningEstimator(learned(), OPTIONS.model_copy(update={"delay_samples": 2}), AdaptationSettings())
    estimate = estimator.advance(estimator.init(30.0, 1.0), 1.2)
    after = estimator.correct(estimate, y)
    assert after.missing == 1
    assert after.disturbance == estimate.disturbance


@pytest.mark.parametrize("kind", ["linearised_mpc", "sampling_mpc"])
def test_the_loop_goes_on_alike_from_a_snapshot_and_keeps_limits(kind: str) -> None:
    case = SOUND[0]
    settings = CONTROLLERS[kind].parse({"kind": kind, "adaptation": {"lag_s": 0.05}, "horizon": 10})
    controller = build_controller(settings, case.predictor, case.inverse, LIMITS)
    random, y = np.random.default_rng(0), case.y_rest
    state, answers = controller.init(case.y_rest, case.u_rest), []
    held = {}
    for k in range(60):
        held[k] = state, y
        wanted = case.y_rest + 8.0 * np.sin(0.1 * (k + np.arange(controller.horizon)))
        before = state.estimate.command
        command, state = controller.step(state, y, wanted)
        y = case.y_rest + 9.0 * (command.u - case.u_rest) + 0.1 * random.standard_normal()
        assert abs(command.u - before) <= LIMITS.rate * DT + 1e-12
        assert LIMITS.lower <= command.u <= LIMITS.upper
        answers.append(command.u)
    state, y = held[30]
    wanted = case.y_rest + 8.0 * np.sin(0.1 * (30 + np.arange(controller.horizon)))
    assert controller.step(state, y, wanted)[0].u == answers[30]


def test_a_pair_is_wrapped_once_and_only_where_asked() -> None:
    case = SOUND[0]
    asked = CONTROLLERS["linearised_mpc"].parse({"kind": "linearised_mpc", "adaptation": {}})
    pair = asked.model_pair(case.predictor, case.inverse)
    assert isinstance(pair[1], LearnedInverse)
    assert asked.model_pair(*pair) == pair
    plain = CONTROLLERS["linearised_mpc"].parse({"kind": "linearised_mpc"})
    assert plain.model_pair(case.predictor, case.inverse) == (case.predictor, case.inverse)


def test_options_out_of_bounds_are_refused() -> None:
    with pytest.raises(ConfigError, match="widest_share"):
        AdaptationSettings.parse({"widest_share": 0.0})
    with pytest.raises(ConfigError, match="walk_share"):
        AdaptationSettings.parse({"walk_share": -1.0})

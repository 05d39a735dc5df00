"""An LSTM in the engine, at every level: how exact, what a batch is, what happens to not-a-number."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threadpoolctl import ThreadpoolController

from hystmpc.models.networks.route import allowed_threads, share
from hystmpc.models.prediction.exported import RoutedPredictor
from hystmpc.trials.errors import ModelError
from hystmpc_lab.performance.lstm_reference import LstmStep

from .lstm_examples import LEVELS, SIZES, facts, make_route, random_weights

ANGLE_DEG, JACOBIAN = 1e-4, 1e-4
HORIZON = 20
EXAMPLES = {name: random_weights(*size) for name, size in (*SIZES.items(), ("two of 20", (20, 2)))}
QUICK = (("one layer of 5", "plain"), ("two of 20", LEVELS[-2:][0]))
every_level = pytest.mark.parametrize("level", LEVELS)
every_size = pytest.mark.parametrize("size", EXAMPLES)


def random_state(size: str, rng: np.random.Generator) -> np.ndarray:
    """Any outputs within (-1, 1) and cells within a few units, in single precision."""
    weights = EXAMPLES[size]
    parts = rng.uniform(-1, 1, (len(weights.layers), 2, weights.hidden)) * np.array([0.9, 2.0])[:, None]
    return parts.ravel().astype(np.float32).astype(float)


@lru_cache
def reference(size: str, seed: int) -> tuple[np.ndarray, ...]:
    """A state, a plan, angles and their Jacobian by the chain rule in float64."""
    rng = np.random.default_rng(seed)
    state, plan = random_state(size, rng), rng.uniform(0, 6, HORIZON)
    step, current = LstmStep(EXAMPLES[size]), state
    angles, jacobian, slopes = np.empty(plan.size), np.zeros((plan.size, plan.size)), np.zeros((state.size, plan.size))
    for k, u in enumerate(plan):
        local = step.jacobian(current, u)
        inner = np.vstack([slopes, np.eye(plan.size)[k]])
        jacobian[k], slopes = local[0] @ inner, local[1:] @ inner
        theta, following = step.advance(current[None], np.array([[u]]))
        angles[k], current = theta[0, 0], following[0]
    return state, plan, angles, jacobian


@pytest.mark.parametrize(
    ("size", "level"),
    [
        pytest.param(size, level, marks=() if (size, level) in QUICK else pytest.mark.slow)
        for size in EXAMPLES
        for level in LEVELS
    ],
)
def test_exact_from_any_state(size: str, level: str) -> None:
    kernel = make_route(EXAMPLES[size], level)
    for seed in range(6):
        state, plan, angles, jacobian = reference(size, seed)
        found, slopes = kernel.linearise(state, plan)
        np.testing.assert_allclose(found, angles, rtol=0, atol=ANGLE_DEG)
        np.testing.assert_allclose(slopes, jacobian, rtol=0, atol=JACOBIAN * np.abs(jacobian).max())
        np.testing.assert_allclose(kernel.advance(state, plan)[0], angles, rtol=0, atol=ANGLE_DEG)
        np.testing.assert_allclose(kernel.rollout(state, plan[None])[0], angles, rtol=0, atol=ANGLE_DEG)


@every_level
@settings(max_examples=25)
@given(count=st.integers(1, 130), horizon=st.integers(1, 6), seed=st.integers(0, 1000))
def test_a_batch_is_its_plans_one_by_one_to_the_last_bit(level: str, count: int, horizon: int, seed: int) -> None:
    rng, kernel = np.random.default_rng(seed), make_route(EXAMPLES["two of 20"], level)
    state, plans = random_state("two of 20", rng), rng.uniform(0, 6, (count, horizon))
    kept = state.copy(), plans.copy()
    angles = kernel.rollout(state, plans)
    for k in {0, count // 3, count - 1}:
        np.testing.assert_array_equal(kernel.rollout(state, plans[k : k + 1])[0], angles[k])
        np.testing.assert_array_equal(kernel.advance(state, plans[k])[0], angles[k])
    np.testing.assert_array_equal(state, kept[0])
    np.testing.assert_array_equal(plans, kept[1])


@every_level
@every_size
def test_a_plan_is_its_samples_one_by_one(size: str, level: str) -> None:
    rng, kernel = np.random.default_rng(2), make_route(EXAMPLES[size], level)
    state, plan = random_state(size, rng), rng.uniform(0, 6, 15)
    angles, following = kernel.advance(state, plan)
    for k, u in enumerate(plan):
        angle, state = kernel.advance(state, np.array([u]))
        np.testing.assert_array_equal(angle[0], angles[k])
    np.testing.assert_array_equal(state, following)


@every_level
@every_size
def test_later_commands_do_not_act_on_earlier_angles(size: str, level: str) -> None:
    rng, kernel = np.random.default_rng(3), make_route(EXAMPLES[size], level)
    state, plan = random_state(size, rng), rng.uniform(0, 6, 12)
    angles, jacobian = kernel.linearise(state, plan)
    shorter, part = kernel.linearise(state, plan[:8])
    assert np.array_equal(jacobian, np.tril(jacobian))
    np.testing.assert_allclose(shorter, angles[:8], rtol=0, atol=2e-5)
    np.testing.assert_allclose(part, jacobian[:8, :8], rtol=0, atol=1e-5 * np.abs(jacobian).max())


@every_level
@every_size
def test_a_hold_holds(size: str, level: str) -> None:
    """Once settled, a constant command gives a constant angle: rounding does not drift."""
    kernel, weights = make_route(EXAMPLES[size], level), EXAMPLES[size]
    _, settled = kernel.advance(np.zeros(weights.state_size), np.full(5000, 2.5))
    held = kernel.rollout(settled, np.full((3, 200), 2.5))
    assert np.ptp(held) < ANGLE_DEG
    assert np.ptp(kernel.linearise(settled, np.full(HORIZON, 2.5))[0]) < ANGLE_DEG


@every_level
@pytest.mark.parametrize("threads", [2, 3])
def test_threads_do_not_change_a_bit(level: str, threads: int) -> None:
    rng, weights = np.random.default_rng(4), EXAMPLES["two of 64"]
    alone, shared = (make_route(weights, level, lambda n=n: n) for n in (1, threads))
    state = random_state("two of 64", rng)
    for count in (95, 96, 256, 301):
        plans = rng.uniform(0, 6, (count, 5))
        np.testing.assert_array_equal(shared.rollout(state, plans), alone.rollout(state, plans))


def test_threads_follow_the_limit_of_blas() -> None:
    with ThreadpoolController().limit(limits=1):
        assert allowed_threads() == 1
    with ThreadpoolController().limit(limits=2):
        assert 1 <= allowed_threads() <= 2


def test_shared_work_is_done_once_and_its_errors_are_heard() -> None:
    done: list[tuple[int, int]] = []
    spans = [(k, k + 1) for k in range(50)]
    share(lambda begin, end: done.append((begin, end)), spans, threads=3)
    assert sorted(done) == spans

    def fail(begin: int, end: int) -> None:
        raise ValueError(f"{begin}")

    with pytest.raises(ValueError, match=r"0|1"):
        share(fail, spans[:2], threads=2)


@every_level
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_does_not_become_an_angle(level: str, bad: float) -> None:
    weights = EXAMPLES["one layer of 5"]
    predictor = RoutedPredictor(facts(weights), "conditioned", make_route(weights, level))
    state, plans = predictor.initial(45.0, 1.0), np.full((5, 4), 2.0)
    fine = predictor.rollout(state, plans)
    plans[3, 2] = bad
    angles = predictor.rollout(state, plans)
    assert np.isnan(angles[3]).all()
    np.testing.assert_allclose(np.delete(angles, 3, 0), np.delete(fine, 3, 0), atol=1e-5)
    theta, jacobian = predictor.linearise(state, plans[3])
    assert np.isnan(theta).all()
    assert np.isnan(jacobian[np.tril_indices(4)]).all()
    assert np.isnan(predictor.advance(state, bad)[0])
    assert np.isnan(predictor.advance(state, bad)[1]).all()
    broken = state.copy()
    broken[2] = bad
    assert np.isnan(predictor.rollout(broken, plans)).all()
    assert np.isnan(predictor.advance(broken, 2.0)[0])
    assert np.isnan(predictor.linearise(broken, plans[0])[0]).all()


@every_level
def test_the_engine_itself_passes_not_a_number_on(level: str) -> None:
    kernel = make_route(EXAMPLES["two of 64"], level)
    plans = np.full((9, 4), 2.0)
    plans[4, 1] = np.nan
    angles = kernel.rollout(np.zeros(256), plans)
    assert np.isnan(angles[4, 1:]).all()
    assert np.isfinite(np.delete(angles, 4, 0)).all()
    assert np.isnan(kernel.linearise(np.zeros(256), plans[4])[0][1:]).all()


@every_level
def test_any_layout_of_the_arguments_is_taken(level: str) -> None:
    rng, kernel = np.random.default_rng(5), make_route(EXAMPLES["three of 7"], level)
    state, plans = random_state("three of 7", rng), rng.uniform(0, 6, (8, 6))
    expected, (angles, jacobian) = kernel.rollout(state, plans), kernel.linearise(state, plans[0])
    strided, state_strided = np.asfortranarray(plans), np.repeat(state, 2)[::2]
    strided.setflags(write=False)
    state_strided.setflags(write=False)
    np.testing.assert_array_equal(kernel.rollout(state_strided, strided), expected)
    again, slopes = kernel.linearise(state_strided, strided[0])
    np.testing.assert_array_equal(again, angles)
    np.testing.assert_array_equal(slopes, jacobian)


@every_level
def test_a_state_of_another_size_is_refused(level: str) -> None:
    kernel, plan = make_route(EXAMPLES["three of 7"], level), np.full(4, 2.0)
    for call in (kernel.advance, kernel.linearise, lambda state, plan: kernel.rollout(state, plan[None])):
        with pytest.raises(ModelError, match=r"got shape \(41,\), expected \(42,\)"):
            call(np.zeros(41), plan)


@every_level
def test_no_plans_give_no_angles(level: str) -> None:
    kernel = make_route(EXAMPLES["three of 7"], level)
    assert kernel.rollout(np.zeros(42), np.empty((0, 5))).shape == (0, 5)

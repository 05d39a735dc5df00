"""The sensor's randomness is an equation: equal in every precision, seeded, with the statistics it is asked for."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.chain import Chain
from hystmpc.models.operators.measurement import Sensor, draw, start_of_seed
from hystmpc.models.program import SCALAR, dense, instructions
from hystmpc.models.stages import prepared
from hystmpc.trials.errors import ModelError

from .running import run_chain
from .zoo import DT

pytestmark = pytest.mark.slow

SAMPLES = 20_000


def readings(sensor: Sensor, value: float = 0.0, samples: int = SAMPLES) -> np.ndarray:
    """What the sensor shows of a constant angle."""
    return run_chain(Chain(sensor), np.full(samples, value), seen=value)


def drawn(state: np.ndarray, kind: type) -> tuple[np.ndarray, float]:
    """Next state and number of `draw`, every instruction rounded to a precision."""
    s = ca.SX.sym("s", 3)
    following, number = draw((s[0], s[1], s[2]))
    values, results = {}, np.zeros(4, dtype=kind)
    for step in instructions(dense("draw", [s], [ca.vertcat(*following, number)])):
        if step.name == "output":
            results[step.out[1]] = values[step.args[0]]
        elif step.name in ("input", "const"):
            values[step.out[0]] = kind(step.value if step.name == "const" else state[step.args[1]])
        else:
            a, b = (values[step.args[k % len(step.args)]] for k in (0, 1))
            values[step.out[0]] = kind(eval(SCALAR[step.name].format("a", "b"), {"a": a, "b": b, "math": math}))
    return results[:3], float(results[3])


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@given(seed=st.integers(0, 2**63 - 1))
def test_draws_are_those_of_the_published_generator_in_single_and_double_precision(kind: type, seed: int) -> None:
    state = np.array(start_of_seed(seed), dtype=kind)
    whole = [int(s) for s in state]
    for _ in range(40):
        state, number = drawn(state, kind)
        whole = [a * s % m for a, s, m in zip((171, 172, 170), whole, (30269, 30307, 30323), strict=True)]
        assert state.dtype == kind
        assert [int(s) for s in state] == whole
        expected = sum(s / m for s, m in zip(whole, (30269, 30307, 30323), strict=True)) % 1.0
        assert min(abs(float(number) - expected), 1 - abs(float(number) - expected)) < 1e-6


def test_draws_are_uniform_and_unrelated() -> None:
    sensor_draws = []
    state: tuple[float, ...] = start_of_seed(3)
    for _ in range(SAMPLES):
        state = tuple(a * s % m for a, s, m in zip((171, 172, 170), state, (30269, 30307, 30323), strict=True))
        sensor_draws.append(sum(s / m for s, m in zip(state, (30269, 30307, 30323), strict=True)) % 1.0)
    found = np.array(sensor_draws)
    counts, _ = np.histogram(found, 20, (0, 1))
    expected = SAMPLES / 20
    assert np.sum((counts - expected) ** 2 / expected) < 43.8  # 0.1 % point of chi-square with 19 degrees
    assert abs(np.corrcoef(found[1:], found[:-1])[0, 1]) < 0.025


@settings(max_examples=10)
@given(sigma=st.floats(0.01, 5.0), seed=st.integers(0, 10**6))
def test_noise_is_white_and_has_the_given_deviation(sigma: float, seed: int) -> None:
    noise = readings(Sensor(0.0, sigma, 0.0, 0.0, 0.0, seed))
    assert np.std(noise) == pytest.approx(sigma, rel=0.03)
    assert abs(np.mean(noise)) < 0.03 * sigma
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.04
    assert np.mean(np.abs(noise) < 1.96 * sigma) == pytest.approx(0.95, abs=0.01)


@settings(max_examples=10)
@given(probability=st.floats(0.01, 0.3), size=st.floats(0.5, 20.0), seed=st.integers(0, 1000))
def test_outliers_come_as_often_and_as_far_as_asked_for(probability: float, size: float, seed: int) -> None:
    shown = readings(Sensor(0.0, 0.0, probability, size, 0.0, seed))
    off = shown != 0
    spread = 5 * np.sqrt(probability * (1 - probability) / SAMPLES)
    assert np.mean(off) == pytest.approx(probability, abs=spread)
    np.testing.assert_allclose(np.abs(shown[off]), size)
    assert np.mean(shown[off] > 0) == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(off.sum()))


@settings(max_examples=10)
@given(probability=st.floats(0.01, 0.3), seed=st.integers(0, 1000))
def test_a_dropout_repeats_the_last_value(probability: float, seed: int) -> None:
    u = np.arange(SAMPLES, dtype=float)
    shown = run_chain(Chain(Sensor(0.0, 0.0, 0.0, 0.0, probability, seed)), u, seen=-1.0)
    repeated = np.diff(shown, prepend=-1.0) == 0
    np.testing.assert_array_equal(shown[~repeated], u[~repeated])
    assert np.mean(repeated) == pytest.approx(probability, abs=5 * np.sqrt(probability / SAMPLES))


@given(step=st.floats(0.01, 5.0), u=st.lists(st.floats(-90.0, 90.0), min_size=1, max_size=20).map(np.array))
def test_rounded_values_are_whole_steps_and_the_nearest(step: float, u: np.ndarray) -> None:
    shown = run_chain(Chain(Sensor(step, 0.0, 0.0, 0.0, 0.0)), u)
    np.testing.assert_allclose(shown / step, np.round(shown / step), atol=1e-8)
    assert np.all(np.abs(shown - u) <= 0.5 * step + 1e-9)


def test_equal_seeds_give_equal_noise_and_others_do_not() -> None:
    sensor = Sensor(0.0, 1.0, 0.0, 0.0, 0.0, 5)
    first = readings(sensor, samples=200)
    np.testing.assert_array_equal(first, readings(sensor, samples=200))
    assert abs(np.corrcoef(first, readings(sensor.reseeded(6), samples=200))[0, 1]) < 0.3
    assert sensor.reseeded(5) == sensor


def test_the_rows_of_a_batch_may_have_their_own_seeds() -> None:
    chain = Chain(Sensor(0.0, 1.0, 0.0, 0.0, 0.0))
    states = np.array([[*start_of_seed(seed), 0.0] for seed in (1, 2, 3)])
    shown, _ = prepared(chain.operators, DT).run(states, np.zeros((3, 50)))
    for k, seed in enumerate((1, 2, 3)):
        alone = readings(Sensor(0.0, 1.0, 0.0, 0.0, 0.0, seed), samples=50)
        np.testing.assert_allclose(shown[k], alone, atol=1e-12)


def test_derivatives_pass_straight_through_rounding() -> None:
    chain = Chain(Sensor(0.5, 0.2, 0.0, 0.0, 0.0))
    u, p = ca.SX.sym("u"), ca.SX.sym("p", 5)
    theta, _ = chain.transition(ca.DM([*start_of_seed(1), 0.0]), u, p, DT)
    by = ca.Function("by", [u, p], [ca.jacobian(theta, u), ca.jacobian(theta, p[1]), theta])
    by_input, by_sigma, _ = (float(v) for v in by(31.3, chain.values))
    noise = readings(Sensor(0.0, 1.0, 0.0, 0.0, 0.0, 1), samples=1)[0]
    assert by_input == 1.0
    assert by_sigma == pytest.approx(noise)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ModelError, match=r"sensor\.seed is -1"):
        Sensor(0.0, 0.0, 0.0, 0.0, 0.0, -1)

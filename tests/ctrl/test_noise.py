"""Laws of the bank of observers: given sigmas are kept, unknown ones found, and no measurement breaks it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.estimation.observer import EstimatorSettings
from hystmpc.ctrl.learning.predictor import LearnedPredictor
from hystmpc.ctrl.mpc_settings import AdaptationSettings
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.trials.types import Vec

from .observing import Seen, Watcher
from .plays import DT, SOUND, Backlash, Case, Lag

AUTO = EstimatorSettings()
RANGE = math.sqrt(6.0)  # of the commands of all models here [mm], under the root


def sigmas(estimator: Watcher, estimate: Seen) -> tuple[float, float, float]:
    """Estimated sigmas of sensor, drift and motion: geometric means over the filters of a model that is not close."""
    weights = estimate.bank[2] * (estimator.bank._widest > 1.0)
    sensor, drift, motion = np.exp(0.5 * (estimator.bank._logs @ weights) / weights.sum()).tolist()
    return sensor, drift, motion


def walk(seconds: float, sensor: float, drift: float, motion: float, seed: int = 1) -> tuple[Vec, Vec]:
    """Commands [mm] that move for a second and rest for a second, and offsets of the angle that walk as asked [deg]."""
    random, count = np.random.default_rng(seed), round(seconds / DT)
    moves = np.where((np.arange(count) // 25) % 2 == 0, 0.1 * (-1.0) ** (np.arange(count) // 50), 0.0)
    steps = np.sqrt(drift**2 * DT + motion**2 * np.abs(moves)) * random.standard_normal(count)
    return np.cumsum(moves), np.cumsum(steps) + sensor * random.standard_normal(count)


def run(estimator: Watcher, commands: Vec, offsets: Vec) -> list[Seen]:
    """The estimates at the ends of the samples, on a device that is the model but for the offsets."""
    estimate, found = estimator.init(20.0, 0.0), []
    for u, offset in zip(commands, offsets, strict=True):
        estimate = estimator.advance(estimate, float(u))
        estimate = estimator.correct(estimate, estimate.angles[0] + float(offset))
        found.append(estimate)
    return found


@pytest.mark.parametrize(
    ("sensor", "drift", "motion"), [(0.15, 0.02, 0.02), (0.03, 0.05, 0.5), (0.3, 0.3, 0.1), (0.1, 0.1, 1.5)]
)
def test_unknown_noises_are_found(sensor: float, drift: float, motion: float) -> None:
    """After half a minute: the sensor's within a quarter, the others in the right place of the grid."""
    estimator = Watcher(Lag(), AUTO)
    found = sigmas(estimator, run(estimator, *walk(30.0, sensor, drift, motion))[-1])
    assert found[0] == pytest.approx(sensor, rel=0.25)
    assert abs(math.log(found[1] / max(drift, 0.01))) < math.log(4.0)
    assert abs(math.log(found[2] / max(motion, 0.02))) < math.log(4.0)


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_a_sensor_other_than_the_file_says_costs_less_than_a_tenth(factor: float) -> None:
    """Against the observer that is told the sensor's sigma, over half a minute with the start."""
    model = type("Known", (Lag,), {"noise": NoiseModel(
        sensor_sigma_deg=0.15 / factor, drift_sigma_deg_per_sqrt_s=0.1, motion_sigma_deg_per_sqrt_unit=0.3
    )})()  # fmt: skip
    commands, offsets = walk(30.0, 0.15, 0.1, 0.3)
    clean = walk(30.0, 0.0, 0.1, 0.3)[1]
    errors = []
    for options in (AUTO, EstimatorSettings(sensor_sigma_deg=0.15)):
        # the same walk under both: the random numbers of walk and sensor are drawn one after another
        estimates = run(Watcher(model, options), commands, offsets)
        errors.append(np.sqrt(np.mean([(e.disturbance - d) ** 2 for e, d in zip(estimates, clean, strict=True)])))
    assert errors[0] < 1.1 * errors[1]


def test_a_model_that_turns_out_wrong_is_found_within_a_second_of_motion() -> None:
    """Ten seconds in which the model is right, then an error of 2 deg/mm: the estimate follows, most of it at once."""
    model, random = Lag(), np.random.default_rng(2)
    estimator = Watcher(model, AUTO)
    commands = np.concatenate([np.linspace(0.0, 3.0, 125), np.linspace(3.0, 0.0, 125), np.linspace(0.0, 3.0, 125)])
    wrong = np.where(np.arange(375) < 250, 0.0, 2.0 * commands)
    estimates = run(estimator, commands, wrong + 0.05 * random.standard_normal(375))
    before, after = sigmas(estimator, estimates[249])[2], sigmas(estimator, estimates[275])[2]
    assert before < 0.1
    assert after > 3.0 * before
    late = [estimate.disturbance - offset for estimate, offset in zip(estimates[275:], wrong[275:], strict=True)]
    assert np.sqrt(np.mean(np.square(late))) < 0.15


@pytest.mark.parametrize(("dt", "most"), [(0.04, 0.5), (0.02, 0.388), (0.004, 0.197), (0.1, 0.666)])
@given(st.floats(-10.0, 10.0), st.integers(0, 20))
@settings(max_examples=20, deadline=None)
def test_a_bank_takes_half_of_what_it_sees_in_40_ms_at_most(dt: float, most: float, step: float, seed: int) -> None:
    """However wrong the model has been, and less the shorter a sample; a single filter takes what its sigmas say."""
    estimator = Watcher(Lag(dt=dt), AUTO)
    before = run(estimator, *walk(3.0, 0.02, 2.0, 2.0, seed))[-1]
    before = estimator.advance(before, before.command)
    before = before.copy()
    before.bank[0] = before.disturbance
    after = estimator.correct(before, before.angles[0] + before.disturbance + step)
    assert abs(after.disturbance - before.disturbance) <= most * abs(step) + 1e-9
    given = EstimatorSettings(sensor_sigma_deg=0.01, drift_sigma_deg_per_sqrt_s=2.0, motion_sigma_deg_per_sqrt_unit=0.0)
    single = Watcher(Lag(), given)
    rest = single.advance(run(single, *walk(3.0, 0.0, 0.0, 0.0))[-1], 0.0)
    moved = single.correct(rest, rest.angles[0] + 1.0).disturbance - rest.disturbance
    assert moved > 0.9


def test_one_spike_says_little() -> None:
    estimator = Watcher(Lag(), AUTO)
    commands, offsets = walk(20.0, 0.1, 0.02, 0.05)
    plain = run(estimator, commands, offsets)[-1]
    offsets[-25] += 10.0
    spiked = run(estimator, commands, offsets)[-1]
    assert spiked.disturbance == pytest.approx(plain.disturbance, abs=0.1)
    assert sigmas(estimator, spiked)[0] == pytest.approx(sigmas(estimator, plain)[0], rel=0.3)


@given(st.floats(0.01, 1.0), st.floats(0.01, 2.0), st.floats(0.0, 3.0), st.integers(0, 50))
@settings(max_examples=20, deadline=None)
def test_given_sigmas_are_used_exactly(sensor: float, drift: float, motion: float, seed: int) -> None:
    """With all three given the bank is the Kalman filter, step by step."""
    options = EstimatorSettings(
        sensor_sigma_deg=sensor, drift_sigma_deg_per_sqrt_s=drift, motion_sigma_deg_per_sqrt_unit=motion
    )
    estimator = Watcher(Lag(), options)
    commands, offsets = walk(2.0, sensor, drift, motion, seed)
    d, p, before = 0.0, estimator.init(20.0, 0.0).variance, 0.0
    for u, offset, estimate in zip(commands, offsets, run(estimator, commands, offsets), strict=True):
        p += drift**2 * DT + motion**2 * abs(u - before)
        d, p, before = d + p / (p + sensor**2) * (offset - d), p * sensor**2 / (p + sensor**2), float(u)
        assert (estimate.disturbance, estimate.variance) == pytest.approx((d, p), rel=1e-9, abs=1e-12)
    assert sigmas(estimator, estimate)[:2] == pytest.approx((sensor, drift))


def test_one_given_sigma_is_kept_and_the_others_are_found() -> None:
    estimator = Watcher(Lag(), EstimatorSettings(drift_sigma_deg_per_sqrt_s=0.07))
    estimates = run(estimator, *walk(20.0, 0.3, 0.0, 0.3))
    assert {round(sigmas(estimator, estimate)[1], 12) for estimate in estimates} == {0.07}
    assert sigmas(estimator, estimates[-1])[0] == pytest.approx(0.3, rel=0.3)


anything = st.one_of(
    st.floats(15.0, 85.0),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([math.nan, math.inf, -math.inf, 1e300, 34.9, -1e4, 20.0]),
)


@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("learns", [False, True], ids=["plain", "learning"])
@given(seen=st.lists(st.tuples(anything, st.floats(0.0, 6.0)), min_size=1, max_size=60))
@settings(max_examples=40, deadline=None)
def test_any_measurement_leaves_the_estimate_finite_and_the_sigmas_in_bounds(
    case: Case, learns: bool, seen: list[tuple[float, float]]
) -> None:
    estimator: Watcher
    if learns:
        estimator = Watcher(LearnedPredictor(case.predictor, AdaptationSettings()), AUTO)
    else:
        estimator = Watcher(case.predictor, EstimatorSettings(delay_samples=1))
    estimate = estimator.init(case.y_rest, case.u_rest)
    for y, u in seen:
        estimate = estimator.advance(estimator.correct(estimate, y), u)
        assert math.isfinite(estimate.disturbance)
        assert abs(estimate.disturbance) <= AUTO.disturbance_limit_deg
        assert 0.0 <= estimate.variance < math.inf
        assert np.isfinite(estimate.bank).all()
        assert np.all(estimate.bank[2] > 0)
        assert float(np.sum(estimate.bank[2])) == pytest.approx(1.0, abs=1e-9)
        sensor, drift, motion = sigmas(estimator, estimate)
        assert 0.1 / 8.01 <= sensor <= 0.8 * 1.01
        assert 0.00099 <= drift <= 2.2
        assert 0.00159 / RANGE <= motion <= 6.56 / RANGE


@pytest.mark.parametrize("learns", [False, True], ids=["plain", "learning"])
def test_an_estimate_is_a_snapshot(learns: bool) -> None:
    """From a stored estimate the future is the same to the last bit, whatever has been done in between."""
    predictor = LearnedPredictor(Backlash(), AdaptationSettings())
    estimator = Watcher(predictor, AUTO) if learns else Watcher(Backlash(), AUTO)
    commands, offsets = walk(4.0, 0.15, 0.1, 0.5)
    stored = run(estimator, 1.0 + np.abs(commands), offsets)[-1]
    bank = stored.bank.copy()
    futures = []
    for _ in range(2):
        estimate = stored
        for k in range(20):
            estimate = estimator.correct(estimator.advance(estimate, 1.0 + 0.1 * k), 35.0 + k)
        futures.append((estimate.disturbance, estimate.variance, estimate.bank.tobytes()))
    assert futures[0] == futures[1]
    np.testing.assert_array_equal(stored.bank, bank)


def test_what_the_file_says_is_where_the_bank_begins() -> None:
    noise = NoiseModel(sensor_sigma_deg=0.4, drift_sigma_deg_per_sqrt_s=0.3, motion_sigma_deg_per_sqrt_unit=0.6)
    told, plain = type("Told", (Lag,), {"noise": noise})(), Lag()
    starts = [sigmas(e, e.init(20.0, 0.0)) for e in (Watcher(told, AUTO), Watcher(plain, AUTO))]
    assert starts[0] == pytest.approx((0.4, 0.3, 0.6), rel=0.35)
    assert all(a > 1.5 * b for a, b in zip(*starts, strict=True))

"""Laws of the output estimator."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.estimation.observer import EstimatorSettings
from hystmpc.trials.errors import ConfigError, ControllerError

from .observing import Seen, Watcher
from .plays import DT, SOUND, Backlash, Case, Lag

OPTIONS = EstimatorSettings(
    sensor_sigma_deg=0.15,
    drift_sigma_deg_per_sqrt_s=0.4,
    motion_sigma_deg_per_sqrt_unit=0.0,
    dead_band_gain_deg_per_unit=1.0,
)


def settled_gain(sensor: float, drift: float, dt: float) -> float:
    """Gain of the observer at rest with given sigmas, after many samples."""
    given = {"sensor_sigma_deg": sensor, "drift_sigma_deg_per_sqrt_s": drift, "motion_sigma_deg_per_sqrt_unit": 0.0}
    estimator = Watcher(Lag(dt=dt), EstimatorSettings(**given))
    estimate, prior = estimator.init(20.0, 0.0), 1.0
    for _ in range(3000):
        prior = estimate.variance
        estimate = estimator.correct(estimate, 20.0)
        gain = 1 - estimate.variance / prior
        estimate = estimator.advance(estimate, 0.0)
    return gain


@pytest.mark.slow
@given(st.floats(0.01, 2.0), st.floats(0.05, 5.0), st.floats(0.004, 0.1))
@settings(max_examples=20, deadline=None)
def test_with_given_sigmas_the_gain_is_the_scalar_riccati_solution(sensor: float, drift: float, dt: float) -> None:
    gain, q, r = settled_gain(sensor, drift, dt), drift**2 * dt, sensor**2
    covariance = r * gain / (1.0 - gain)
    assert covariance == pytest.approx(covariance - covariance**2 / (covariance + r) + q, rel=1e-6)


@pytest.mark.parametrize(("sensor", "drift", "dt"), [(0.15, 0.4, 0.04), (0.15, 1.5, 0.004), (2.0, 0.1, 0.04)])
def test_with_given_sigmas_the_gain_is_that_of_control(sensor: float, drift: float, dt: float) -> None:
    from control import dlqe

    one = np.eye(1)
    gain, _, _ = dlqe(one, one, one, drift**2 * dt * one, sensor**2 * one, method="scipy")
    assert settled_gain(sensor, drift, dt) == pytest.approx(float(np.asarray(gain).item()), rel=1e-9)


def test_the_error_of_the_estimate_has_the_predicted_variance() -> None:
    """The disturbance walks as assumed, faster while the command moves; both kinds of sample are judged apart."""
    options = EstimatorSettings(
        sensor_sigma_deg=0.15,
        drift_sigma_deg_per_sqrt_s=0.4,
        motion_sigma_deg_per_sqrt_unit=1.5,
        dead_band_gain_deg_per_unit=0.0,
        disturbance_limit_deg=1e3,
        outlier_deg=1e3,
    )
    model, random = Lag(), np.random.default_rng(0)
    estimator = Watcher(model, options)
    estimate, state = estimator.init(20.0, 0.0), model.initial(20.0, 0.0)
    offset, u, squares = 0.0, 0.0, {True: [], False: []}
    angle, state = model.advance(state, 0.0)
    for k in range(20_000):
        estimate = estimator.correct(estimate, angle + offset + 0.15 * random.standard_normal())
        moving = (k // 50) % 2 == 0
        if k % 50 > 40:  # settled in either
            squares[moving].append(((offset - estimate.disturbance) ** 2, estimate.variance))
        move = 0.1 * (-1) ** k if moving else 0.0
        u += move
        estimate = estimator.advance(estimate, u)
        angle, state = model.advance(state, u)
        offset += math.sqrt(0.4**2 * DT + 1.5**2 * abs(move)) * random.standard_normal()
    means = {moving: np.mean(pairs, axis=0) for moving, pairs in squares.items()}
    for error, variance in means.values():
        assert error == pytest.approx(variance, rel=0.1)
    assert means[True][1] > 1.5 * means[False][1]


def test_the_first_measurement_is_worth_one_measurement() -> None:
    """Angles at rest with a model that does not drift are averaged, the first one like the others."""
    still = OPTIONS.model_copy(update={"drift_sigma_deg_per_sqrt_s": 1e-9})
    estimator, seen = Watcher(Lag(), still), np.random.default_rng(0).normal(20.0, 0.15, 30)
    estimate = estimator.init(float(seen[0]), 0.0)
    for k, y in enumerate(seen, 1):  # a controller shows its observer the angle of the start once more
        estimate = estimator.correct(estimate, float(y))
        assert estimate.variance == pytest.approx(0.15**2 / k, rel=0.02)
        assert estimate.angles[0] + estimate.disturbance == pytest.approx(np.mean(seen[:k]), abs=0.01)
        estimate = estimator.advance(estimate, 0.0)


@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("delay", [0, 3])
def test_disturbance_converges_to_a_constant_offset(case: Case, delay: int) -> None:
    estimator = Watcher(case.predictor, EstimatorSettings(delay_samples=delay))
    state, estimate = case.predictor.initial(case.y_rest, case.u_rest), estimator.init(case.y_rest, case.u_rest)
    y, under_way = case.y_rest, [case.u_rest] * delay
    for k in range(150):
        estimate = estimator.correct(estimate, y + 2.5)
        u = 2.0 + 1.5 * math.sin(0.1 * k)
        estimate = estimator.advance(estimate, u)
        under_way.append(u)
        y, state = case.predictor.advance(state, under_way.pop(0))
        # a delayed measurement meets the prediction of its own instant
        assert estimate.angles[0] == pytest.approx(y, abs=1e-9)
    assert estimate.disturbance == pytest.approx(2.5, abs=1e-3)


def _in_the_dead_band(estimator: Watcher) -> Seen:
    model = Backlash()
    estimate = estimator.init(50.0, 50.0 / model.m_up - model.c_up)
    return estimator.advance(estimate, estimate.command - 0.1)


def test_disturbance_rests_while_the_model_crosses_its_dead_band() -> None:
    estimator = Watcher(Backlash(), OPTIONS)
    estimate = _in_the_dead_band(estimator)
    assert estimate.angles[0] == pytest.approx(50.0)
    assert estimator.correct(estimate, 47.0).disturbance == estimate.disturbance
    held = estimator.advance(estimate, estimate.command)  # at rest the offset is looked for again
    assert estimator.correct(held, 47.0).disturbance < estimate.disturbance


@pytest.mark.parametrize("y", [math.nan, math.inf, 1e300, 80.0])
def test_missing_and_outlying_measurements_leave_the_prediction(y: float) -> None:
    estimator = Watcher(Lag(), OPTIONS)
    estimate = estimator.init(20.0, 0.0)
    corrected = estimator.correct(estimator.correct(estimate, y), y)
    assert (corrected.disturbance, corrected.missing) == (estimate.disturbance, 2)
    assert estimator.correct(corrected, 20.1).missing == 0


def test_an_angle_near_the_last_one_is_no_outlier_however_far_the_model_has_gone() -> None:
    """A device that stands still while its model goes 40 deg: the disturbance has to find that out."""
    estimator = Watcher(Lag(), OPTIONS)
    estimate = estimator.init(20.0, 0.0)
    for _ in range(60):
        estimate = estimator.correct(estimator.advance(estimate, 6.0), 20.0)
        assert estimate.missing == 0
    assert estimate.angles[0] > 60.0
    assert estimate.angles[0] + estimate.disturbance == pytest.approx(20.0, abs=1.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_disturbance_is_bounded(side: float) -> None:
    """No filter passes the bound; those of a close model keep the mean a little within it."""
    estimator = Watcher(Lag(), EstimatorSettings(disturbance_limit_deg=3.0))
    estimate = estimator.init(20.0, 0.0)
    for _ in range(200):
        corrected = estimator.correct(estimate, 20.0 + estimate.disturbance + 10.0 * side)
        estimate = estimator.advance(corrected, 0.0)
    assert float(np.max(side * corrected.bank[0])) == 3.0
    assert 3.0 * (1.0 - 2e-5) < side * estimate.disturbance <= 3.0


@pytest.mark.parametrize(
    ("angle", "state"),
    [(math.nan, 0.0), (math.inf, 0.0), (1e300, 0.0), (-2e4, 0.0), (20.0, math.nan), (20.0, -math.inf)],
)
def test_a_model_that_answers_no_number_is_not_advanced(
    angle: float, state: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One such state would stay in the estimate for ever."""
    estimator = Watcher(Lag(), OPTIONS)
    estimate = estimator.init(20.0, 0.0)
    monkeypatch.setattr(Lag, "advance", lambda self, before, u: (angle, np.full_like(before, state)))
    coasted = estimator.advance(estimate, 1.0)
    assert (coasted.stalled, coasted.command) == (1, 1.0)
    assert np.isfinite(coasted.state).all()


def test_what_the_model_cannot_explain_at_rest_is_the_first_disturbance() -> None:
    estimator = Watcher(Backlash(), OPTIONS)
    estimate = estimator.init(40.0, 0.0)  # the unloading line gives 28.98 deg
    assert estimate.angles[0] + estimate.disturbance == pytest.approx(40.0)
    with pytest.raises(ControllerError, match=r"got 80 deg at rest with command 0, the model expects 28\.98"):
        estimator.init(80.0, 0.0)


@pytest.mark.parametrize(
    "change",
    [
        {"sensor_sigma_deg": 0.0},
        {"drift_sigma_deg_per_sqrt_s": math.nan},
        {"delay_samples": -1},
        {"dead_band_gain_deg_per_unit": -1.0},
        {"motion_sigma_deg_per_sqrt_unit": -0.1},
    ],
)
def test_impossible_options_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(change))):
        EstimatorSettings.parse(change)

"""Frames of an intermittent sensor are used at the instant at which they were taken, whenever they arrive."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl import Source
from hystmpc.ctrl.config import parse_controller
from hystmpc.ctrl.estimation.observer import EstimatorSettings
from hystmpc.ctrl.learning.predictor import LearnedPredictor
from hystmpc.ctrl.mpc_settings import AdaptationSettings
from hystmpc.trials.errors import ConfigError, ControllerError
from hystmpc.trials.types import Vec

from .observing import Seen, Watcher
from .plays import PLAY, SOUND, Case
from .test_tip_controller import controller_for, plant_for

FRAMES = {"estimator": {"sensor": "intermittent"}}
COUNT = 24
COMMANDS = PLAY.u_rest + 1.5 * (1.0 - np.cos(np.linspace(0.0, 5.0, COUNT)))


def observer(**changes: Any) -> Watcher:
    return Watcher(PLAY.predictor, EstimatorSettings.parse({"sensor": "intermittent", **changes}, "estimator"))


def led(found: Watcher, angles: dict[int, float], late: dict[int, int]) -> Seen:
    """After COUNT samples of one motion; the angle of instant k is shown `late[k]` samples afterwards."""
    estimate = found.init(PLAY.y_rest, PLAY.u_rest)
    for now, u in enumerate(COMMANDS.tolist()):
        for taken, wait in late.items():
            if wait and taken + wait == now:
                estimate = found.correct_late(estimate, angles[taken], wait)
        shown = angles[now] if now in angles and not late.get(now) else math.nan
        estimate = found.advance(found.correct(estimate, shown), u)
    return estimate


@settings(max_examples=30, deadline=None)
@given(st.dictionaries(st.integers(2, 12), st.tuples(st.floats(-2.0, 2.0), st.integers(0, 10)), max_size=5))
def test_a_late_frame_leaves_what_it_would_have_left_on_time(frames: dict[int, tuple[float, int]]) -> None:
    """Whatever their order of arrival, with as many others as there are."""
    angles = {k: PLAY.y_rest + shift for k, (shift, _) in frames.items()}
    on_time = led(observer(), angles, dict.fromkeys(angles, 0))
    late = led(observer(), angles, {k: wait for k, (_, wait) in frames.items()})
    for name in ("disturbance", "variance", "angles", "missing"):
        np.testing.assert_allclose(getattr(late, name), getattr(on_time, name), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(late.bank, on_time.bank, rtol=1e-9, atol=1e-12)


def test_between_two_samples_the_model_carries_the_frame() -> None:
    """A frame that shows what the model says at its own instant changes no disturbance; two that do not, do."""
    found = observer()
    estimate = found.init(PLAY.y_rest, PLAY.u_rest)
    seen = [estimate.angles[0]]
    for u in PLAY.u_rest + np.cumsum(np.full(8, 0.3)):
        estimate = found.advance(found.correct(estimate, math.nan), float(u))
        seen.append(estimate.angles[0])
    for age in (0.0, 0.25, 1.0, 2.75, 4.0):
        shown = float(np.interp(len(seen) - 1 - age, np.arange(len(seen)), seen))
        assert found.correct_late(estimate, shown, age).disturbance == pytest.approx(estimate.disturbance, abs=1e-9)
        once = found.correct_late(estimate, shown + 1.0, age)
        assert once.disturbance == estimate.disturbance  # nothing has borne it out yet
        assert found.correct_late(once, shown + 1.0, age).disturbance > estimate.disturbance + 0.1


def framed(shift_deg: float, noise_deg: float, seed: int, every: int = 3) -> Vec:
    """Estimated disturbance [deg] along 600 samples of a motion of a device that is off its model by `shift_deg`."""
    found, random = observer(sensor_sigma_deg=noise_deg), np.random.default_rng(seed)
    estimate, disturbance = found.init(PLAY.y_rest, PLAY.u_rest), []
    for k in range(600):
        shown = estimate.angles[0] + shift_deg + noise_deg * random.standard_normal()
        estimate = found.correct(estimate, shown if k % every == 0 else math.nan)
        disturbance.append(estimate.disturbance)
        estimate = found.advance(estimate, PLAY.u_rest + 1.5 - 1.5 * math.cos(0.1 * k))
    return np.array(disturbance)


@pytest.mark.parametrize("noise_deg", [0.3, 1.0])
def test_noise_of_frames_about_a_right_model_hardly_enters(noise_deg: float) -> None:
    errors = np.array([framed(0.0, noise_deg, seed) for seed in range(4)])
    assert np.sqrt(np.mean(errors**2)) <= 0.15 * noise_deg


@pytest.mark.parametrize("shift_deg", [-3.0, 1.0, 5.0])
def test_a_wrong_model_is_found_by_its_frames(shift_deg: float) -> None:
    """Within the first 2 s in most part, for good after 8 s."""
    error = framed(shift_deg, 0.3, 1) - shift_deg
    seconds = np.arange(error.size) * PLAY.predictor.dt
    assert np.abs(error[seconds >= 2.0]).max() <= 0.5 * abs(shift_deg)
    assert np.sqrt(np.mean(error[seconds >= 8.0] ** 2)) <= 0.2


@pytest.mark.parametrize(("y", "age"), [(math.nan, 1.0), (math.inf, 1.0), (40.0, -0.5), (40.0, 4.5), (40.0, math.nan)])
def test_what_cannot_be_used_is_refused(y: float, age: float) -> None:
    found = observer()
    estimate = found.init(PLAY.y_rest, PLAY.u_rest)
    for _ in range(4):
        estimate = found.advance(found.correct(estimate, math.nan), PLAY.u_rest)
    with pytest.raises(ControllerError, match="expected a finite angle of the last 25 samples since the start"):
        found.correct_late(estimate, y, age)


def test_a_frame_older_than_the_memory_is_refused() -> None:
    found = observer(oldest_frame_s=4 * PLAY.predictor.dt)
    estimate = found.init(PLAY.y_rest, PLAY.u_rest)
    for _ in range(20):
        estimate = found.advance(found.correct(estimate, math.nan), PLAY.u_rest)
    found.correct_late(estimate, PLAY.y_rest, 4.0)
    with pytest.raises(ControllerError, match="expected a finite angle of the last 4"):
        found.correct_late(estimate, PLAY.y_rest, 4.5)


@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("kind", ["linearised_mpc", "inverse_pid"])
def test_late_frames_of_a_device_that_is_off_lead_it_to_the_target(case: Case, kind: str) -> None:
    """Five frames a second, a fifth of a second late; the device is 3 deg off its model."""
    tip, plant = controller_for(case, kind, **FRAMES), plant_for(case)
    tip.measure(plant.reset(), 0.0)
    tip.set_target(50.0)
    every = round(0.2 / tip.dt)
    true, pending = math.nan, []
    for k in range(500):
        true = plant.apply(tip.step(math.nan).u)
        shown = true + (3.0 if k > 100 else 0.0)
        if k % every == 0:
            pending.append((k + every, shown, tip.state().time_s))
        while pending and pending[0][0] <= k:
            _, y, taken = pending.pop(0)
            tip.measure(y, taken)
    assert not tip.state().stopped
    assert true + 3.0 == pytest.approx(50.0, abs=0.3)


def test_gaps_are_bridged_as_long_as_the_settings_say() -> None:
    tip, plant = (
        controller_for(PLAY, "linearised_mpc", estimator={"sensor": "intermittent", "longest_gap_s": 2.0}),
        plant_for(),
    )
    tip.measure(plant.reset(), 0.0)
    tip.set_target(50.0)
    sources = [tip.step(math.nan).source for _ in range(round(4.0 / tip.dt))]
    bridged = round(2.0 / tip.dt)
    assert set(sources[:bridged]) == {Source.MPC}
    assert sources[bridged + 1] is Source.HOLD
    assert sources[-1] is Source.STOP


def test_other_sensors_know_no_frames_and_learning_wants_a_sensor() -> None:
    for block in ({}, {"estimator": {"sensor": "none"}}):
        tip = controller_for(PLAY, "linearised_mpc", **block)
        tip.reset(PLAY.y_rest)
        tip.step(PLAY.y_rest)
        with pytest.raises(ControllerError, match="sensor intermittent"):
            tip.measure(PLAY.y_rest, 0.0)
    with pytest.raises(ConfigError, match="expected a sensor"):
        parse_controller({"kind": "linearised_mpc", "adaptation": {}, "estimator": {"sensor": "none"}}, "controller")


def frames_of_a_changed_device(teach: bool, factor: float, seconds: float = 40.0) -> float:
    """RMSE of the last ten seconds [deg].

    Five frames a second, a fifth of a second late, with half a degree of noise. The device answers to its command
    `factor` times as much as its model says.
    """
    block = {} if teach else {"adaptation": None}
    sensor = {"estimator": {"sensor": "intermittent", "sensor_sigma_deg": 0.5}}
    tip, plant, random = controller_for(PLAY, "linearised_mpc", **sensor, **block), plant_for(PLAY), np.random
    rest, noise = plant.reset(), random.default_rng(1)
    tip.measure(rest, 0.0)
    tip.set_reference(lambda t: rest + 12.0 * (1.0 - np.cos(0.9 * t)))
    true, pending, errors = rest, list[tuple[int, float, float]](), list[float]()
    for k in range(round(seconds / tip.dt)):
        while pending and pending[0][0] <= k:
            _, y, taken = pending.pop(0)
            tip.measure(y, taken)
        true = rest + factor * (plant.apply(tip.step(math.nan).u) - rest)
        errors.append(true - rest - 12.0 * (1.0 - math.cos(0.9 * (k + 1) * tip.dt)))
        if k % 5 == 0:
            pending.append((k + 6, true + noise.normal(0.0, 0.5), tip.state().time_s))
    return math.sqrt(np.mean(np.square(errors[-round(10.0 / tip.dt) :])))


@pytest.mark.parametrize("factor", [1.4, 1.1])
def test_frames_teach_what_a_changed_device_does(factor: float) -> None:
    taught, plain = (frames_of_a_changed_device(teach, factor) for teach in (True, False))
    assert taught < 0.4 * plain


def test_frames_of_the_device_as_modelled_teach_nothing() -> None:
    taught, plain = (frames_of_a_changed_device(teach, 1.0) for teach in (True, False))
    assert taught == plain


def taught() -> Watcher:
    """Observer whose frames teach when they are ten samples old."""
    estimator = EstimatorSettings.parse({"sensor": "intermittent", "oldest_frame_s": 0.4}, "estimator")
    return Watcher(LearnedPredictor(PLAY.predictor, AdaptationSettings()), estimator)


def test_frames_of_every_instant_teach_what_a_continuous_sensor_does() -> None:
    """Ten samples later; the instant of the start has been measured twice."""
    learner = LearnedPredictor(PLAY.predictor, AdaptationSettings())
    estimator = {"sensor": "intermittent", "oldest_frame_s": 0.4, "sensor_sigma_deg": 0.1}
    angle, x = PLAY.predictor.advance(PLAY.predictor.initial(PLAY.y_rest, PLAY.u_rest), PLAY.u_rest)
    bank = learner.filters(0)
    state = bank.correct(bank.init(angle, PLAY.u_rest, PLAY.y_rest), PLAY.y_rest, angle, 0.0)
    angles = dict[int, float]()
    for k, u in enumerate(COMMANDS[: COUNT - 10].tolist()):
        angles[k] = angle + math.sin(k)
        state = bank.correct(state, angles[k], angle, 0.0)
        angle, x = PLAY.predictor.advance(x, u)
        state = bank.advance(state, u)
    watcher = Watcher(learner, EstimatorSettings.parse(estimator, "estimator"))
    late = led(watcher, angles, dict.fromkeys(angles, 0))
    np.testing.assert_allclose(late.taught.z, state.z, rtol=1e-9, atol=1e-12)


def test_an_outlier_teaches_nothing() -> None:
    angles = {2: PLAY.y_rest, 4: PLAY.y_rest + 1.0, 6: PLAY.y_rest + 2.0}
    without, beside = (
        led(taught(), angles | more, dict.fromkeys(angles | more, 3)) for more in ({}, {5: PLAY.y_rest + 60.0})
    )
    np.testing.assert_array_equal(beside.taught.z, without.taught.z)


@settings(max_examples=15, deadline=None)
@given(st.permutations(range(1, 9)))
def test_the_order_in_which_frames_arrive_teaches_the_same(waits: list[int]) -> None:
    angles = {2 + k: PLAY.y_rest + 3.0 * k for k in range(8)}
    late, on_time = (led(taught(), angles, dict(zip(angles, order, strict=True))) for order in (waits, [0] * 8))
    np.testing.assert_allclose(late.taught.z, on_time.taught.z, rtol=1e-9, atol=1e-12)
    assert np.abs(on_time.taught.z[:, 1:]).max() > 0.0

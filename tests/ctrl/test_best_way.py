"""The predictive controller is no worse than its own inverse, nor a sensor than none, where the model is right.

What is learned never stops it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hystmpc
from hystmpc.ctrl.build import build_controller, pair_for
from hystmpc.ctrl.command import limits_of_model
from hystmpc.ctrl.config import parse_controller
from hystmpc.ctrl.estimation.observer import EstimatorSettings
from hystmpc.ctrl.learning.bank import _OF_SHARE, DELAYS
from hystmpc.ctrl.learning.predictor import LearnedPredictor
from hystmpc.ctrl.mpc_settings import AdaptationSettings, WeightsSettings
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.operators.dynamics import Delay, Servo
from hystmpc.models.operators.dynamics import Lag as DriveLag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.prediction.build import ControllerModel, controller_model
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.types import Vec

from .observing import Watcher
from .plays import Lag
from .test_noise import run

DT, LEAD_IN, APPROACH = 0.04, 50, 75
SERVO = Servo(0.13, 0.8, 0)
DRIVES: dict[str, tuple[Operator, ...]] = {
    "none": (),
    "delay": (Delay.at_rate(0.08, DT),),
    "creep": (Creep((-0.1,), (3.0,)),),
    "servo": (SERVO,),
    "lag": (DriveLag(0.2, (), 0),),
}


def known(drive: str) -> ControllerModel:
    own = hystmpc.load_model("builtin:backlash").simulator
    return controller_model(ChainModel(replace(own, chain=replace(own.chain, before=DRIVES[drive])), "conditioned"))


def reference(model: ControllerModel, hz: float) -> Vec:
    """A ramp from rest, then a scan that grows out of a hold."""
    predictor, limits = model.predictive[0], limits_of_model(model.facts)
    ends = np.array([np.full(100, limits.lower), np.full(100, limits.upper)])
    low, high = predictor.rollout(predictor.initial(30.0, limits.lower), ends)[:, -1]
    t, middle = DT * np.arange(300), 0.5 * (low + high)
    grown = np.clip(t, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(t, 0.0, 1.0))
    scan = middle + grown * 0.1 * (high - low) * np.sin(2.0 * np.pi * hz * t)
    return np.concatenate([np.linspace(low, middle, LEAD_IN), np.full(APPROACH - LEAD_IN, middle), scan])


def error(
    model: ControllerModel, kind: str, hz: float, sensor: str, noise: float = 0.0, seed: int = 0, **more: Any
) -> float:
    """RMSE of the true angle behind the approach, on a device that is its model [deg]."""
    options = parse_controller({"kind": kind, "estimator": {"sensor": sensor}, **more}, "controller")
    limits, predictor, wanted = limits_of_model(model.facts), model.predictive[0], reference(model, hz)
    controller, random = build_controller(options, *pair_for(options, model), limits), np.random.default_rng(seed)
    y, x = predictor.advance(predictor.initial(30.0, limits.lower), limits.lower)
    state, off = controller.init(y, limits.lower), []
    ahead = np.append(wanted, np.full(controller.horizon, wanted[-1]))
    for k in range(wanted.size):
        command, state = controller.step(state, y + noise * random.standard_normal(), ahead[k : k + controller.horizon])
        y, x = predictor.advance(x, command.u)
        off.append(y - wanted[k])
    return float(np.sqrt(np.mean(np.square(off[APPROACH:]))))


@pytest.mark.parametrize("hz", [0.2, 0.6])
@pytest.mark.parametrize("drive", ["none", "delay", "creep"])
def test_an_exact_model_is_followed_as_well_as_by_its_inverse(drive: str, hz: float) -> None:
    model = known(drive)
    assert error(model, "linearised_mpc", hz, "none") <= error(model, "inverse", hz, "none") * (1.0 + 1e-6)


@pytest.mark.parametrize("hz", [0.2, 0.6])
@pytest.mark.parametrize("drive", ["none", "delay", "servo"])
def test_a_noisy_sensor_does_not_harm_where_the_model_is_right(drive: str, hz: float) -> None:
    """To a hundredth of a degree, a fifteenth of the noise: the exact model alone leaves next to nothing."""
    model = known(drive)
    errors = [error(model, "linearised_mpc", hz, "continuous", 0.15, seed) for seed in range(3)]
    assert np.sqrt(np.mean(np.square(errors))) <= 1.05 * error(model, "linearised_mpc", hz, "none") + 0.01


@pytest.mark.parametrize("hz", [0.2, 0.6])
@pytest.mark.parametrize("drive", ["lag", "servo"])
def test_behind_a_slow_drive_a_plan_is_as_good_as_the_inverse(drive: str, hz: float) -> None:
    """Moves that cost ten times those of the inverse gave 2.4 times its error."""
    model = known(drive)
    assert error(model, "linearised_mpc", hz, "none") <= 1.1 * error(model, "inverse", hz, "none")


@pytest.mark.parametrize("hz", [0.2, 0.6])
@pytest.mark.parametrize("drive", ["lag", "servo"])
def test_noise_costs_a_slow_drive_a_twentieth_of_it(drive: str, hz: float) -> None:
    """The weight on moves follows the probability of a close model on a scale of logarithms."""
    model = known(drive)
    errors = [error(model, "linearised_mpc", hz, "continuous", 0.15, seed) for seed in range(3)]
    assert np.sqrt(np.mean(np.square(errors))) <= 1.05 * error(model, "linearised_mpc", hz, "none") + 0.0025


def told(error_deg: float) -> Watcher:
    """Observer of a model whose file says this error [deg]."""
    noise = NoiseModel(
        sensor_sigma_deg=0.1,
        drift_sigma_deg_per_sqrt_s=0.1,
        motion_sigma_deg_per_sqrt_unit=0.2,
        model_sigma_deg=error_deg,
    )
    return Watcher(type("Told", (Lag,), {"noise": noise})(), EstimatorSettings())


def closeness(offset: float, seconds: float, error_deg: float = 0.1) -> float:
    """Weight of the filters of a close model after a noisy scan of a device that is off its model by `offset` [deg]."""
    estimator = told(error_deg)
    random, commands = np.random.default_rng(3), 3.0 - 2.5 * np.cos(0.5 * np.pi * DT * np.arange(round(seconds / DT)))
    found = run(estimator, commands, offset * commands + 0.15 * random.standard_normal(commands.size))[-1]
    return float(found.bank[2][estimator.bank._widest < 1.0].sum())


def test_a_model_is_known_to_be_close_or_not_after_a_few_seconds() -> None:
    """Its file says nothing, so that close is 0.1 deg: an exact model, and one whose gain is off by 2 deg/mm."""
    assert closeness(0.0, 10.0) > 0.8
    assert closeness(2.0, 2.0) < 0.05


@pytest.mark.parametrize("error_deg", [0.25, 0.5])
def test_a_model_that_is_better_than_its_file_says_is_close(error_deg: float) -> None:
    """Else filters of a slow walk foretell it best, it counts as wrong, and noise moves the plan: it was below 0.03."""
    assert closeness(0.0, 40.0, error_deg) > 0.9
    assert closeness(2.0, 2.0, error_deg) < 0.05


def test_what_only_follows_noise_is_not_believed() -> None:
    """The disturbance of an exact model stays within a twentieth of the noise, that of the bank is a third of it."""
    commands, off = 3.0 - 2.5 * np.cos(0.5 * np.pi * DT * np.arange(1000)), []
    for seed in range(4):
        found = run(Watcher(Lag(), EstimatorSettings()), commands, 0.15 * np.random.default_rng(seed).normal(size=1000))
        off += [estimate.disturbance for estimate in found[500:]]
    assert np.sqrt(np.mean(np.square(off))) <= 0.15 / 20


@pytest.mark.parametrize("error_deg", [0.02, 0.1, 0.5])
def test_the_error_of_a_close_model_keeps_its_variance(error_deg: float) -> None:
    """A filter of the greatest variance s^2 without measurements keeps it, and its disturbance returns to zero."""
    estimator = told(error_deg)
    estimate = estimator.init(20.0, 0.0).copy()
    close = estimator.bank._widest < 1.0
    estimate.bank[0] = error_deg
    for k in range(500):
        estimate = estimator.advance(estimate, 3.0 + 3.0 * (-1.0) ** k)
    variances = estimate.bank[1][close]
    np.testing.assert_allclose(variances, estimator.bank._widest[close], rtol=1e-9)
    assert (variances.min(), variances.max()) == pytest.approx((0.01 * error_deg**2, error_deg**2), rel=1e-9)
    assert np.all(np.abs(estimate.bank[0][close]) < 0.5 * error_deg)


@pytest.mark.parametrize("error_deg", [0.02, 0.1, 0.5])
def test_the_error_of_a_close_model_lasts_over_a_hundredth_of_the_range(error_deg: float) -> None:
    """One that is new in each sample cannot be told from the sensor's noise, which the plan then follows."""
    estimator = told(error_deg)
    estimate = estimator.init(20.0, 0.0).copy()
    close = estimator.bank._widest < 1.0
    estimate.bank[0] = error_deg
    estimate = estimator.advance(estimate, 0.01 * Lag().command_range[1])
    assert estimate.bank[0][close].min() > 0.5 * error_deg


def test_moves_cost_what_the_probability_of_a_close_model_says() -> None:
    """One weight where one is given; without a sensor the model is all there is."""
    both = WeightsSettings()
    assert both.rate_close < both.rate
    assert WeightsSettings(rate=2.0).rate_close == 2.0
    assert WeightsSettings.model_validate({"rate": 2.0, "rate_close": 0.5}).rate_close == 0.5
    model = known("none")
    fixed = {"weights": {"rate": both.rate_close}}
    ours = error(model, "linearised_mpc", 0.2, "none")
    assert ours == error(model, "linearised_mpc", 0.2, "none", **fixed)
    assert ours < error(model, "linearised_mpc", 0.2, "none", weights={"rate": both.rate})


@pytest.mark.parametrize("drive", ["servo", "lag"])
def test_the_plan_of_a_close_model_is_finished(drive: str) -> None:
    """As one more linearisation a step would; without a sensor the model is all there is."""
    model = known(drive)
    for sensor in ("continuous", "none"):
        ours, two, three = (
            error(model, "linearised_mpc", 0.2, sensor, 0.05, **more)
            for more in ({}, {"iterations": 2}, {"iterations": 3})
        )
        assert ours == two
        assert ours != three


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.sampled_from([1.0, 10.0, 100.0]), u=st.sampled_from([0.0, 1.7, 4.2, 6.0]))
def test_what_is_learned_never_makes_a_model_deaf(seed: int, size: float, u: float) -> None:
    """Whatever the filters hold, the way to either end of the range moves the angle by 0.3 of what the model says.

    A device with a dead band of half the range had taught that it does not answer: every plan stood still for good.
    """
    learned = LearnedPredictor(Lag(), AdaptationSettings())
    estimator = Watcher(learned, EstimatorSettings())
    estimate = estimator.init(20.0 + 10.0 * u, u)
    for _ in range(80):
        estimate = estimator.advance(estimate, u)
    estimate = estimate.copy()
    bank = estimate.learned
    weights = size * np.random.default_rng(seed).standard_normal(bank.weights.size)
    weights[-3:] = 0.0  # slow followers and the rate, which are no matter of where the command ends
    bank.z[bank.delay, 1:, bank.best // DELAYS] = weights
    bank.filters[_OF_SHARE] = 1.0
    low, high = Lag().command_range
    plans = np.array([np.full(150, end) for end in (u, low, high)])
    ends = learned.rollout(estimator.state(estimate), plans)[:, -1]
    alone = Lag().rollout(Lag().initial(20.0 + 10.0 * u, u), plans)[:, -1]
    for end in (1, 2):
        way = alone[end] - alone[0]
        if way != 0.0:
            assert (ends[end] - ends[0]) / way >= 0.3 - 1e-6

"""A controller without an angle sensor follows its model from a declared rest on, whatever is measured."""

from __future__ import annotations

import math
from copy import copy
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl import Source
from hystmpc.ctrl.config import parse_controller
from hystmpc.ctrl.estimation.observer import EstimatorSettings
from hystmpc.trials.errors import ConfigError

from .observing import Watcher
from .plays import PLAY, SOUND, Case
from .test_tip_controller import LIMITS, controller_for, plant_for

KINDS = ("linearised_mpc", "sampling_mpc", "inverse")
NONE = {"estimator": {"sensor": "none"}}
kinds = pytest.mark.parametrize("kind", KINDS)


def commands(kind: str, angles: list[Any], case: Case = PLAY) -> list[float]:
    """Commands towards 50 deg from a declared rest, one for each angle that is shown."""
    tip = controller_for(case, kind, **NONE)
    tip.reset(case.y_rest)
    tip.set_target(50.0)
    return [tip.step(y).u for y in angles]


@kinds
@settings(max_examples=15, deadline=None)
@given(angles=st.lists(st.floats(allow_nan=True, allow_infinity=True) | st.none(), min_size=20, max_size=20))
def test_what_is_measured_changes_nothing(kind: str, angles: list[Any]) -> None:
    assert commands(kind, angles) == commands(kind, [math.nan] * 20)


@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@kinds
def test_a_device_that_is_its_model_is_led_to_the_target_and_rests_there(case: Case, kind: str) -> None:
    tip, plant = controller_for(case, kind, **NONE), plant_for(case)
    tip.reset(plant.reset())
    assert tip.set_target(50.0)
    sent, y = [], math.nan
    for _ in range(400):
        sent.append(tip.step(math.nan).u)
        y = plant.apply(sent[-1])
    state = tip.state()
    assert (state.settled, state.stopped) == (True, False)
    assert y == pytest.approx(50.0, abs=0.1)
    assert state.measured_deg == pytest.approx(y, abs=1e-6)
    assert np.ptp(sent[-200:]) < 1e-6
    assert np.max(np.abs(np.diff(sent))) <= LIMITS.rate * tip.dt * (1 + 1e-9)


@kinds
def test_it_starts_where_a_rest_is_declared_and_stops_as_any_other(kind: str) -> None:
    tip = controller_for(PLAY, kind, **NONE)
    assert "reset(angle)" in tip.step(math.nan).status
    assert tip.step(math.nan).u == PLAY.u_rest
    tip.reset(PLAY.y_rest)
    tip.set_target(50.0)
    for _ in range(5):
        tip.step(math.nan)
    tip.stop()
    held = tip.state().command
    assert {tip.step(math.nan).source for _ in range(50)} == {Source.STOP}
    assert tip.state().command == held


def test_a_recording_prepares_it_with_one_angle() -> None:
    tip = controller_for(PLAY, "linearised_mpc", **NONE)
    moves = np.linspace(PLAY.u_rest, PLAY.u_rest + 1.0, 30)
    tip.replay(moves, np.append(PLAY.y_rest, np.full(29, np.nan)))
    state = PLAY.predictor.initial(PLAY.y_rest, PLAY.u_rest)
    theta, state = PLAY.predictor.advance(state, PLAY.u_rest)
    for u in moves:
        theta, state = PLAY.predictor.advance(state, float(u))
    tip.step(math.nan)
    assert tip.state().measured_deg == pytest.approx(theta, abs=1e-9)


def test_it_says_how_far_the_model_may_be_off_where_the_file_does() -> None:
    for said in (math.nan, 0.25):
        predictor = copy(PLAY.predictor)
        object.__setattr__(predictor, "model_sigma_deg", said)  # the tests' models are frozen
        alone = Watcher(predictor, EstimatorSettings(sensor="none"))
        assert alone.sigma_deg(alone.init(PLAY.y_rest, PLAY.u_rest)) == pytest.approx(said, nan_ok=True)


def test_with_a_sensor_the_uncertainty_is_that_of_the_estimate() -> None:
    tip, plant = controller_for(PLAY, "linearised_mpc"), plant_for(PLAY)
    y = plant.reset()
    tip.reset(y)
    sigmas = []
    for _ in range(50):
        y = plant.apply(tip.step(y).u)
        sigmas.append(tip.state().sigma_deg)
    assert 0 < sigmas[-1] < sigmas[0]
    assert math.isnan(controller_for(PLAY, "pid").state().sigma_deg)


@pytest.mark.parametrize(
    "block",
    [{"kind": "pid", **NONE}, {"kind": "inverse_pid", **NONE}, {"kind": "linearised_mpc", "adaptation": {}, **NONE}],
    ids=["pid", "inverse_pid", "learn"],
)
def test_what_needs_a_sensor_refuses_to_be_without(block: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="sensor"):
        parse_controller(block, "controller")
    assert EstimatorSettings().sensor == "continuous"

"""A device that has changed is told from one that has not, by what has changed."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.monitor import SIGNS, ChangeMonitor
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.trials.types import Vec

DT, LOW, HIGH, USUAL = 0.04, 20.0, 80.0, 0.1
T = DT * np.arange(round(60.0 / DT))
MODEL = 50.0 + 20.0 * np.sin(0.9 * T) + 9.0 * np.sin(2.3 * T + 1.0)
"""A motion over nearly all angles [deg]."""

NOISE = NoiseModel(
    sensor_sigma_deg=0.1, drift_sigma_deg_per_sqrt_s=0.1, motion_sigma_deg_per_sqrt_unit=0.1, model_sigma_deg=USUAL
)
MONITOR = ChangeMonitor(NOISE, DT, (LOW, HIGH))
SEEN = np.random.default_rng(3).normal(0.0, 0.3, T.size)
"""Noise of the sensor [deg]."""


def late(angles: Vec, lag_s: float) -> Vec:
    """Behind a lag."""
    out, now = np.empty_like(angles), angles[0]
    for k, angle in enumerate(angles):
        now += (1.0 - math.exp(-DT / lag_s)) * (angle - now)
        out[k] = now
    return out


def played(angles: Vec, width_deg: float) -> Vec:
    """Behind a play."""
    out, now = np.empty_like(angles), angles[0]
    for k, angle in enumerate(angles):
        now = min(max(now, angle - 0.5 * width_deg), angle + 0.5 * width_deg)
        out[k] = now
    return out


CHANGED: dict[str, Callable[[Vec], Vec]] = {
    "offset": lambda angle: angle + 2.0,
    "lag": lambda angle: late(angle, 0.15),
    "friction": lambda angle: played(angle, 4.0),
    "stiffness": lambda angle: LOW + 0.85 * (angle - LOW),
    "slack": lambda angle: np.maximum(angle, LOW + 10.0),
    "creep": lambda angle: angle + 0.4 * (late(angle, 8.0) - angle),
}


def test_every_sign_has_a_change_here() -> None:
    assert set(CHANGED) == set(SIGNS)


@pytest.mark.parametrize("sign", SIGNS)
def test_a_change_is_said_within_a_minute_and_by_its_name(sign: str) -> None:
    change, when_s = MONITOR.along(MODEL, CHANGED[sign](MODEL) + SEEN)
    assert change.certain
    assert when_s <= 60.0
    assert change.signs[0][0] == sign
    assert sum(share for _, share in change.signs) == pytest.approx(1.0)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.floats(0.0, 2.0), st.floats(0.05, 0.5))
def test_a_model_as_far_off_as_usual_is_no_change(seed: int, times: float, noise_deg: float) -> None:
    """Up to twice its usual error, however noisy the sensor."""
    random = np.random.default_rng(seed)
    slow = times * USUAL * math.sqrt(2.0) * np.sin(random.uniform(0.2, 1.0) * T + random.uniform(0, 6))
    change, when_s = MONITOR.along(MODEL, MODEL + slow + random.normal(0.0, noise_deg, T.size))
    assert not change.certain
    assert math.isnan(when_s)


def test_nothing_is_said_of_a_rest_nor_of_missing_angles_nor_without_a_usual_error() -> None:
    rest = np.full(T.size, 50.0)
    assert math.isnan(MONITOR.along(rest, rest + 5.0)[0].probability)
    assert math.isnan(MONITOR.along(MODEL, np.full(T.size, math.nan))[0].probability)
    assert math.isnan(ChangeMonitor(None, DT, (LOW, HIGH)).along(MODEL, MODEL + 5.0)[0].probability)


def test_a_first_angle_that_is_missing_hides_nothing() -> None:
    measured = MODEL + 3.0
    measured[0] = math.nan
    assert MONITOR.along(MODEL, measured)[0].certain


def test_a_change_that_is_over_is_forgotten() -> None:
    twice = np.concatenate([MODEL, MODEL, MODEL])
    measured = np.concatenate([MODEL + 3.0, MODEL, MODEL])
    state = MONITOR.init(float(twice[0]), float(measured[0]))
    for model, angle in zip(twice.tolist(), measured.tolist(), strict=True):
        state = MONITOR.advance(state, model, angle)
    assert not MONITOR.change(state).certain

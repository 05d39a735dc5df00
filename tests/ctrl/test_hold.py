"""Laws of the hold: a predictive controller on a straight line, whose observer says how far the angle is off."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.command import Command, CommandLimits
from hystmpc.ctrl.guarded import GuardedState
from hystmpc.ctrl.mpc_settings import HoldSettings, LinearisedMpcSettings
from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ConfigError

from .plays import DT, Lag, LagInverse
from .scripted import scripted

LIMITS = CommandLimits(0.0, 6.0, 12.0)
PATIENCE, SETTLE, SLOPE = 10, 3, 10.0
HOLD: dict[str, Any] = {
    "tolerance_deg": 0.03,
    "patience_s": 0.4,
    "settle_after_s": 0.4,
    "settle_s": SETTLE * DT,
}
H = 5
STILL = np.full(H, 60.0)
ANGLE, COMMAND = 60.0, 4.0
line = Lag(a=0.0, g=SLOPE)


class Bench:
    """The controller at rest at 60 deg; `held` keeps its command, whatever it wants."""

    def __init__(self, error: float = 0.0, predictor: Predictor = line, **hold: Any) -> None:
        wanted = LinearisedMpcSettings(horizon=H, hold=HoldSettings(**{**HOLD, **hold}))
        self.controller, self.script = scripted(wanted, predictor, LagInverse(line), LIMITS)
        self._angle, self._command = ANGLE + error, COMMAND + error / SLOPE
        self.state: GuardedState = self.controller.init(self._angle, self._command)

    def step(self, reference: np.ndarray = STILL) -> Command:
        command, self.state = self.controller.step(self.script.written(self.state), self._angle, reference)
        return command

    def held(self, samples: int) -> bool:
        """Whether it holds after some samples."""
        for _ in range(samples):
            command = self.step()
            assert command.u == self._command or not self.holding
            self.state = self.controller.holding(self.state, self._command)
        return self.holding

    @property
    def holding(self) -> bool:
        return bool(self.state.head.holding)


def after(samples: int, error: float, sigma: float) -> bool:
    """Whether it holds after some samples at 60 deg, the held command being off by `error`."""
    bench = Bench(error)
    bench.script.sigma = sigma
    return bench.held(samples)


def test_close_enough_is_held_at_once() -> None:
    assert after(2, 0.02, 0.0)
    assert not after(2, 0.04, 10.0)


@settings(max_examples=10)
@given(st.floats(0.1, 2.0), st.floats(0.01, 0.5))
def test_noise_is_allowed_for_by_and_by(sigmas: float, sigma: float) -> None:
    patient = PATIENCE * (1 + int(np.ceil(sigmas)))
    assert after(patient + 2, 0.03 + 0.99 * sigmas * sigma, sigma)
    assert not after(6 * PATIENCE, 0.03 + 5.01 * sigma, sigma)


def test_what_is_held_is_left_for_more_than_noise_alone() -> None:
    for off, stays in ((0.4, True), (-0.4, True), (0.6, False), (-0.6, False)):
        bench = Bench()
        assert bench.held(20)
        bench.script.disturbance, bench.script.sigma = off, 0.1
        bench.step()
        assert bench.holding is stays


def test_a_slow_ramp_is_no_hold() -> None:
    bench = Bench()
    bench.script.sigma = 1.0
    for k in range(100):
        bench.step(60.0 + 0.02 * np.arange(k, k + H, dtype=np.float64))
        assert bench.state.head.constant <= 2


def corrected(samples: int, off: float, **hold: Any) -> np.ndarray:
    """Deviations of the plan (H,) from the command after some samples of rest, the angle being off from then on."""
    bench = Bench(**hold)
    assert bench.held(samples)
    bench.script.disturbance = off
    plan = bench.step().plan
    assert not bench.holding
    return plan - COMMAND


@settings(max_examples=10)
@given(st.floats(0.05, 3.0), st.sampled_from([-1.0, 1.0]))
def test_limited_corrections_are_no_faster_and_no_farther(error: float, way: float) -> None:
    limited, free = corrected(20, way * error), corrected(20, way * error, settle_s=0.0)
    grain = 1e-7 * LIMITS.rate * DT
    assert np.all(np.abs(limited) <= np.abs(free) + grain)
    assert np.all(np.abs(limited) <= error / (SETTLE * SLOPE) * np.arange(1, H + 1) + grain)
    assert np.max(np.abs(np.diff(limited, prepend=0.0))) <= LIMITS.rate * DT + grain
    assert way * limited[0] < 0.0


def test_before_a_hold_plans_are_left_alone() -> None:
    np.testing.assert_array_equal(corrected(2, 0.5), corrected(2, 0.5, settle_s=0.0))
    assert not np.array_equal(corrected(20, 0.5), corrected(20, 0.5, settle_s=0.0))


def hurried(samples: int, off: float, sigma: float) -> float:
    """First move behind a lag after some samples of rest, over the move that the angle needs in the end."""
    bench = Bench(predictor=Lag(a=0.98, g=SLOPE), settle_s=0.0)
    bench.script.sigma = sigma
    assert bench.held(samples)
    bench.script.disturbance = off
    return (COMMAND - bench.step().u) / (off / SLOPE)


@settings(max_examples=10)
@given(st.floats(0.1, 0.3), st.sampled_from([-1.0, 1.0]), st.integers(2, PATIENCE + 5))
def test_at_rest_a_lag_is_not_hurried_for_what_may_be_noise(error: float, way: float, samples: int) -> None:
    at_once = hurried(samples, way * error, 0.0)
    assert at_once > 10.0
    assert 0.0 < hurried(samples, way * error, 0.01) < at_once / 3


def test_nonsense_is_refused() -> None:
    with pytest.raises(ConfigError, match="patience_s"):
        HoldSettings.parse({"patience_s": -1.0})

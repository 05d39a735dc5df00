"""Laws of the hold rule."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl.mpc import Hold, HoldRule
from hystmpc.ctrl.mpc_settings import HoldSettings
from hystmpc.trials.errors import ConfigError

DT, PATIENCE = 0.04, 10
RULE = HoldRule(HoldSettings(tolerance_deg=0.03, patience_s=0.4, lead_s=0.0, settle_after_s=0.4, settle_s=0.12), DT)
H = 5


def after(samples: int, error: float, sigma: float, rule: HoldRule = RULE) -> Hold:
    """The answer after some samples at 60 deg, the held command being off by `error`."""
    hold = Hold()
    for _ in range(samples):
        hold = rule.judge(hold, np.full(H, 60.0), np.full(H, 60.0 + error), sigma)
    return hold


def test_close_enough_is_held_at_once() -> None:
    assert after(2, 0.02, 0.0).holding
    assert not after(2, 0.04, 10.0).holding


@given(st.floats(0.1, 2.0), st.floats(0.01, 0.5))
def test_noise_is_allowed_for_by_and_by(sigmas: float, sigma: float) -> None:
    patient = PATIENCE * (1 + int(np.ceil(sigmas)))
    assert after(patient + 2, 0.03 + 0.99 * sigmas * sigma, sigma).holding
    assert not after(300, 0.03 + 5.01 * sigma, sigma).holding


def test_what_is_held_is_left_for_more_than_noise_alone() -> None:
    held = Hold(holding=True, constant=20, target=60.0)
    assert RULE.judge(held, np.full(H, 60.0), np.full(H, 60.4), 0.1).holding
    assert not RULE.judge(held, np.full(H, 60.0), np.full(H, 60.6), 0.1).holding


def test_a_slow_ramp_is_no_hold() -> None:
    hold = Hold()
    for k in range(100):
        wanted = 60.0 + 0.02 * np.arange(k, k + H, dtype=np.float64)
        hold = RULE.judge(hold, wanted, np.full(H, wanted[0]), 1.0)
        assert hold.constant <= 2


@pytest.mark.parametrize(("lead", "kept"), [(1, True), (3, False)])
def test_the_lead_is_how_early_the_next_move_is_seen(lead: int, kept: bool) -> None:
    rule = HoldRule(HoldSettings(tolerance_deg=0.03, lead_s=lead * DT), DT)
    held, ahead = Hold(holding=True, constant=20, target=60.0), np.array([60.0, 60.0, 61.0, 62.0, 63.0])
    assert rule.judge(held, ahead, np.full(H, 60.0), 0.0).holding is kept


@given(st.lists(st.floats(-3, 3), min_size=H, max_size=H), st.floats(0, 2), st.floats(0.1, 20))
def test_limited_corrections_are_no_faster_and_no_farther(moves: list[float], error: float, slope: float) -> None:
    plan, hold = np.cumsum(moves), Hold(constant=50, target=60.0)
    limited = RULE.limited_correction(hold, plan, 0.0, error, slope)
    assert np.all(np.abs(limited) <= np.abs(plan) + 1e-12)
    assert np.abs(limited[0]) <= error / (3 * slope) + 1e-12
    reach = max(abs(m) for m in moves)
    assert np.max(np.abs(np.diff(limited, prepend=0.0))) <= reach + 1e-9


def test_before_a_hold_plans_are_left_alone() -> None:
    plan = np.array([1.0, 2.0, 3.0])
    assert RULE.limited_correction(Hold(constant=2), plan, 0.0, 0.1, 10.0) is plan
    assert RULE.limited_correction(Hold(constant=50), plan, 0.0, 0.1, 0.0) is plan


def test_nonsense_is_refused() -> None:
    with pytest.raises(ConfigError, match="lead_s"):
        HoldSettings.parse({"lead_s": -1.0})

"""Laws of the effects: neutral is the identity, exact answers to steps and ramps, bounded loops, one error line."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.chain import Chain
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.effects.pictures import DEVICE, shown_effect
from hystmpc.models.effects.place import (
    effect_from,
    effect_operator,
    neutral_operator,
    with_effect,
)
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.friction import StickSlip
from hystmpc.models.operators.operator import Operator

from .running import run_chain
from .zoo import BACKLASH, DT, STATIC_PI

pytestmark = pytest.mark.slow

SIDES = [(name, side) for name, effect in EFFECTS.items() for side in effect.sides]
SIZES = {"delay": {"samples": 3}}
signals = st.lists(st.floats(-5.0, 90.0), min_size=2, max_size=30).map(np.array)
commands = st.lists(st.floats(0.0, 6.0), min_size=2, max_size=30).map(np.array)


def neutral(name: str) -> Operator:
    return neutral_operator(name, **SIZES.get(name, {}))


def shown(name: str, k: int = 0) -> Operator:
    return effect_operator(name, EFFECTS[name].shown[k], DT)


def step_response(operator: Operator, samples: int, dt: float = DT) -> np.ndarray:
    """Answer to a unit step, the first entry before it."""
    return run_chain(Chain(operator), np.concatenate([[0.0], np.ones(samples)]), dt=dt)


@pytest.mark.parametrize("name", EFFECTS)
@given(u=signals)
def test_neutral_is_the_identity_to_the_last_bit(name: str, u: np.ndarray) -> None:
    np.testing.assert_array_equal(run_chain(Chain(neutral(name)), u, seen=float(u[0])), u)


@pytest.mark.parametrize(("name", "side"), SIDES)
def test_a_neutral_effect_changes_nothing_in_any_chain(name: str, side: str) -> None:
    u = 3 - 3 * np.cos(0.9 * np.arange(80) * DT) + np.sin(7 * np.arange(80) * DT)
    for core in (BACKLASH, STATIC_PI):
        chain = with_effect(Chain(core), neutral(name), side)  # type: ignore[arg-type]
        np.testing.assert_allclose(run_chain(chain, u, 30.0), run_chain(Chain(core), u, 30.0), atol=1e-12)


@pytest.mark.parametrize("name", EFFECTS)
def test_as_shown_it_is_not_the_identity(name: str) -> None:
    u = np.concatenate([np.linspace(0, 6, 40), np.full(5, 6.0), np.linspace(6, 2, 40)])
    plain = run_chain(DEVICE, u, 22.0)
    for k in range(len(EFFECTS[name].shown)):
        placed = shown_effect(name, k)
        assert np.max(np.abs(run_chain(with_effect(DEVICE, placed.operator, placed.side), u, 22.0) - plain)) > 0.5


@given(tau=st.floats(0.02, 5.0), dt=st.floats(0.004, 0.1))
def test_lag_answers_a_step_by_its_exponential(tau: float, dt: float) -> None:
    expected = 1 - np.exp(-np.arange(31) * dt / tau)
    np.testing.assert_allclose(step_response(effect_operator("lag", {"tau_s": tau}), 30, dt), expected, atol=1e-12)


def test_lag_of_two_ways_rises_and_falls_at_its_own_rates() -> None:
    lag = effect_operator("lag", {"tau_up_s": 0.2, "tau_down_s": 0.8})
    y = run_chain(Chain(lag), np.concatenate([np.zeros(1), np.ones(5), np.zeros(20)]))
    np.testing.assert_allclose(y[5], 1 - math.exp(-1), atol=1e-12)
    np.testing.assert_allclose(y[25], y[5] * math.exp(-1), atol=1e-12)


@given(share=st.floats(-1.0, 0.9), tau=st.floats(0.1, 20.0))
def test_creep_shows_a_step_and_settles_to_what_is_left(share: float, tau: float) -> None:
    creep = effect_operator("creep", {"share": share, "tau_s": tau})
    t = np.arange(41) * DT
    expected = np.concatenate([[0.0], 1 - share * (1 - np.exp(-t[1:] / tau))])
    np.testing.assert_allclose(step_response(creep, 40), expected, atol=1e-12)
    settled = step_response(creep, 40, dt=tau)
    assert settled[-1] == pytest.approx(1 - share, abs=1e-9)


def test_two_exponentials_of_creep_add_up() -> None:
    both = effect_operator("creep", {"share_1": 0.2, "tau_1_s": 1.0, "share_2": -0.1, "tau_2_s": 10.0})
    single = [effect_operator("creep", {"share": s, "tau_s": tau}) for s, tau in ((0.2, 1.0), (-0.1, 10.0))]
    answers = [step_response(creep, 50) for creep in (both, *single)]
    np.testing.assert_allclose(answers[0][1:], answers[1][1:] + answers[2][1:] - 1.0, atol=1e-12)


@given(speed=st.floats(0.2, 20.0), width=st.floats(0.0, 0.3))
def test_rate_dependence_lags_by_width_times_speed_and_lets_go_in_a_hold(speed: float, width: float) -> None:
    ramp = speed * np.arange(60) * DT
    y = run_chain(
        Chain(effect_operator("rate_dependence", {"width_s": width})), np.concatenate([ramp, np.full(3, ramp[-1])])
    )
    np.testing.assert_allclose((ramp - y[:60])[20:], width * speed, atol=1e-9)
    np.testing.assert_array_equal(y[60:], ramp[-1])


@given(speed=st.floats(0.2, 20.0), memory=st.floats(0.02, 1.0))
def test_a_friction_that_remembers_the_speed_lets_go_by_and_by(speed: float, memory: float) -> None:
    ramp = speed * np.arange(400) * DT
    held = np.full(20, ramp[-1])
    rate = effect_operator("rate_dependence", {"width_s": 0.1, "memory_s": memory})
    behind = ramp[-1] - run_chain(Chain(rate), np.concatenate([ramp, held]))[400:]
    np.testing.assert_allclose(behind, 0.1 * speed * np.exp(-np.arange(1, 21) * DT / memory), rtol=1e-6, atol=1e-6)


@given(lean=st.floats(-2.0, 2.0), skew=st.floats(-0.8, 0.8), speed=st.floats(0.2, 20.0))
def test_what_multiplies_a_pull_divides_a_release(lean: float, skew: float, speed: float) -> None:
    rate = effect_operator("rate_dependence", {"width_s": 0.1, "lean": lean, "skew": skew})
    up = speed * np.arange(400) * DT
    u = np.concatenate([up, up[::-1]])
    y = run_chain(Chain(rate), u)
    pull, release = u[399] - y[399], y[-1] - u[-1]
    assert pull * release == pytest.approx((1 - skew**2) * (0.1 * speed) ** 2)
    ratio = (1 + abs(lean) * speed) ** (2 if lean >= 0 else -2)
    assert release * (1 - skew) == pytest.approx(ratio * pull * (1 + skew))


@given(speed=st.floats(0.2, 20.0), way=st.floats(0.05, 2.0), stretch=st.floats(0.0, 3.0))
def test_drag_with_presliding_stays_in_a_hold_and_goes_over_its_way(speed: float, way: float, stretch: float) -> None:
    drag = effect_operator("dahl_drag", {"width_s": 0.1, "way": way, "stretch": stretch})
    level, distance = 0.1 * speed, 40 * (way + stretch * 0.1 * speed)
    fast = np.arange(0.0, distance, speed * DT)
    slow = fast[-1] + np.arange(1, 2000) * 1e-3 * speed * DT
    u = np.concatenate([fast, np.full(50, fast[-1]), slow])
    behind = u - run_chain(Chain(drag), u)
    np.testing.assert_allclose(behind[fast.size - 1 : fast.size + 50], level, rtol=1e-6)
    gone = np.exp(-(slow - fast[-1]) / (way + stretch * 1e-3 * level))
    np.testing.assert_allclose(behind[fast.size + 50 :], 1e-3 * level + 0.999 * level * gone, rtol=1e-6)


@given(
    tau=st.floats(0.05, 0.5), speeds=st.lists(st.floats(0.1, 20.0) | st.floats(-20.0, -0.1), min_size=1, max_size=20)
)
def test_in_motion_a_drag_without_presliding_is_a_lag(tau: float, speeds: list[float]) -> None:
    u = np.cumsum([0.0, *(DT * speed for speed in speeds)])
    drag = effect_operator("dahl_drag", {"width_s": tau, "way": 1e-6})
    lag = Lag(tau, hold=1)
    np.testing.assert_allclose(run_chain(Chain(drag), u), run_chain(Chain(lag), u), atol=1e-4)


def test_drift_counts_minutes_and_travel() -> None:
    u = np.concatenate([[0.0], np.linspace(0, 3, 500), np.linspace(3, 1, 500), np.full(499, 1.0)])  # one minute
    by_time = run_chain(Chain(effect_operator("drift", {"offset_per_min": 2.0, "gain_per_min": 0.5})), u)
    assert by_time[-1] == pytest.approx(1.0 + 2.0 + 0.5)
    by_use = run_chain(Chain(effect_operator("drift", {"offset_per_travel": 0.1})), u)
    assert by_use[-1] == pytest.approx(1.0 + 0.1 * 5.0)


def test_a_set_is_taken_once() -> None:
    flexure = effect_operator("first_flexure", {"set": 0.2, "threshold": 1.0})
    once = np.concatenate([np.linspace(0, 4, 40), np.linspace(4, 0, 40)])
    y = run_chain(Chain(flexure), np.concatenate([once, once, 1.5 * once]))
    np.testing.assert_allclose(y[40:160] - np.tile(once, 2)[40:160], 0.2 * 3.0, atol=1e-12)
    assert y[-1] == pytest.approx(0.2 * 5.0)
    below = run_chain(Chain(flexure), 0.25 * once)
    np.testing.assert_array_equal(below, 0.25 * once)


@given(break_away=st.floats(0.05, 1.0), speed=st.floats(0.02, 10.0))
def test_stick_slip_is_never_further_off_than_its_break_away(break_away: float, speed: float) -> None:
    u = speed * np.arange(200) * DT
    y = run_chain(Chain(effect_operator("stick_slip", {"break_away": break_away, "stribeck_speed": 1.0})), u)
    assert np.all(np.abs(u - y) <= break_away + 1e-9)
    assert np.all(np.diff(y) >= -1e-12)


def test_stick_slip_jumps_when_slow_and_slides_when_fast() -> None:
    operator = effect_operator("stick_slip", {"break_away": 0.4, "stribeck_speed": 1.0})

    def increments(speed: float) -> np.ndarray:
        return np.diff(run_chain(Chain(operator), speed * np.arange(1500) * DT))[500:]

    slow, fast = increments(0.2), increments(8.0)
    stuck = np.flatnonzero(slow == 0.0)
    assert stuck.size > 0.7 * slow.size
    slips = [slow[a + 1 : b].sum() for a, b in itertools.pairwise(stuck) if b > a + 1]
    # d = break_away (1 - exp(-d / (stribeck_speed memory_s))): 0.393 here, and a little motion on the way.
    np.testing.assert_allclose(slips, 0.393, atol=0.06)
    np.testing.assert_allclose(fast, 8.0 * DT, atol=1e-9)


@given(angle=st.floats(0.0, 60.0), u=signals)
def test_contact_of_ratio_zero_is_a_stop(angle: float, u: np.ndarray) -> None:
    stop = Chain(effect_operator("contact", {"angle": angle, "stiffness_ratio": 0.0}))
    np.testing.assert_allclose(run_chain(stop, u), np.minimum(u, angle), atol=1e-9)


@given(slack=st.floats(0.0, 3.0), u=commands)
def test_slack_is_a_dead_zone_at_low_command(slack: float, u: np.ndarray) -> None:
    np.testing.assert_array_equal(
        run_chain(Chain(effect_operator("slack", {"slack": slack})), u), np.maximum(u - slack, 0)
    )


@given(above=st.floats(1.0, 3.0), below=st.floats(0.2, 1.0), pivot=st.floats(0.0, 6.0))
def test_asymmetry_does_not_drift_and_has_its_slopes(above: float, below: float, pivot: float) -> None:
    numbers = {"slope_ratio_above": above, "slope_ratio_below": below, "pivot": pivot}
    cycle = np.concatenate([np.linspace(0, 6, 61), np.linspace(6, 0, 61)[1:]])
    y = run_chain(Chain(effect_operator("asymmetry", numbers)), np.tile(cycle, 12))
    np.testing.assert_array_equal(y[-121:], y[121:242])
    width = y[121:][61:121] - cycle[61:]
    assert np.all(width >= -1e-12)
    opened = (above - 1) * np.maximum(cycle[61:] - pivot, 0) + (1 - below) * np.maximum(pivot - cycle[61:], 0)
    assert np.all(width <= opened + 1e-9)


def test_periodic_disturbance_does_not_know_the_command() -> None:
    heart = Chain(effect_operator("periodic_disturbance", {"frequency_hz": 1.1, "amplitude": 0.5, "phase_rad": 0.3}))
    u = np.linspace(0, 50, 4000)
    t = DT * np.arange(1, 4001)
    np.testing.assert_allclose(run_chain(heart, u) - u, 0.5 * np.sin(2 * np.pi * 1.1 * t + 0.3), atol=1e-9)


@pytest.mark.parametrize(
    "name", ["lag", "delay", "creep", "drift", "periodic_disturbance", "contact", "trial_shift", "slack"]
)
def test_the_sample_time_makes_no_difference_to_what_a_held_command_shows(name: str) -> None:
    u = 3 + 2 * np.sin(np.arange(100) * DT) + np.arange(100) / 50
    spec = {"effect": name, "parameters": dict(EFFECTS[name].shown[0])}
    coarse = run_chain(Chain(effect_from(spec, DT).operator), u)
    fine = run_chain(Chain(effect_from(spec, DT / 4).operator), np.repeat(u, 4), dt=DT / 4)
    # The rest of a fractional delay lies between other neighbours at another rate.
    late = np.abs(fine[3::4] - coarse)[5:]
    assert late.max() <= (0.05 if name == "delay" else 1e-9)


@pytest.mark.parametrize("name", ["rate_dependence", "stick_slip", "asymmetry", "nonlinear_gain"])
def test_the_sample_time_makes_little_difference_to_a_motion(name: str) -> None:
    t = np.arange(0, 6, DT / 4)
    u, operator = 3 - 3 * np.cos(2 * np.pi * 0.3 * t), shown(name) if name != "stick_slip" else StickSlip(0.5, 2.0)
    coarse, fine = run_chain(Chain(operator), u[::4]), run_chain(Chain(operator), u, dt=DT / 4)[::4]
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < (0.1 if name == "stick_slip" else 0.03)

"""PID controllers between and after the frames of an intermittent sensor."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl import Source
from hystmpc.ctrl.config import CONTROLLERS, parse_controller
from hystmpc.ctrl.estimation.observer import SensorKindSettings
from hystmpc.trials.errors import ConfigError, ControllerError

from .observing import Watcher
from .plays import PLAY, SOUND, Case
from .test_tip_controller import LIMITS, controller_for, plant_for

FRAMES = {"estimator": {"sensor": "intermittent"}}


def newest(oldest: int) -> Watcher:
    """The newest measurement, frames being used up to an age of so many samples."""
    asked = SensorKindSettings(sensor="intermittent", oldest_frame_s=oldest * PLAY.predictor.dt)
    return Watcher(PLAY.predictor, asked)


kinds = pytest.mark.parametrize("kind", ["pid", "inverse_pid"])
any_float = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=40, deadline=None)
@given(
    st.dictionaries(st.integers(0, 1200).map(lambda k: k / 100), st.floats(-5.0, 5.0), min_size=1, max_size=6),
    st.randoms(),
)
def test_the_frame_taken_last_counts_whatever_their_order_of_arrival(frames: dict[float, float], mixed: Any) -> None:
    found, arrivals = newest(25), list(frames)
    mixed.shuffle(arrivals)
    estimate = found.init(PLAY.y_rest, PLAY.u_rest)
    for _ in range(20):
        estimate = found.advance(found.correct(estimate, math.nan), PLAY.u_rest)
    for age in arrivals:
        estimate = found.correct_late(estimate, frames[age], age)
    youngest = min(frames)
    assert estimate.measured == frames[youngest]
    assert estimate.age == pytest.approx(youngest)


@pytest.mark.parametrize(("y", "age"), [(math.nan, 1.0), (math.inf, 1.0), (40.0, -0.5), (40.0, 4.5), (40.0, math.nan)])
def test_what_cannot_be_used_is_refused(y: float, age: float) -> None:
    found = newest(4)
    with pytest.raises(ControllerError, match="expected a finite angle of the last 4"):
        found.correct_late(found.init(PLAY.y_rest, PLAY.u_rest), y, age)


@pytest.mark.parametrize("kind", sorted(CONTROLLERS))
@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(st.one_of(st.floats(20.0, 90.0), any_float), st.floats(-0.3, 2.0)), max_size=25))
def test_no_frame_makes_a_step_raise_or_leave_the_limits(kind: str, frames: list[tuple[float, float]]) -> None:
    tip = controller_for(PLAY, kind, **FRAMES, **({"samples": 16} if kind == "sampling_mpc" else {}))
    tip.measure(PLAY.y_rest, 0.0)
    tip.set_target(55.0)
    before = tip.state().command
    for y, late_s in frames:
        u = tip.step(math.nan).u
        assert LIMITS.lower <= u <= LIMITS.upper
        assert abs(u - before) <= LIMITS.rate * tip.dt * (1 + 1e-9)
        before = u
        with suppress(ControllerError):
            tip.measure(y, tip.state().time_s - late_s)


@pytest.mark.parametrize("case", SOUND[:1], ids=lambda c: c.name)
@kinds
def test_frames_lead_a_device_that_is_off_to_the_target(case: Case, kind: str) -> None:
    """Five frames a second, a fifth of a second late; feedback gentle enough for so much delay."""
    gains = {"gains": {"kp_per_deg": 0.005, "ki_per_deg_s": 0.05, "dead_zone_deg": 0.0}}
    tip, plant = controller_for(case, kind, **FRAMES, **gains), plant_for(case)
    tip.measure(plant.reset(), 0.0)
    tip.set_target(50.0)
    every = round(0.2 / tip.dt)
    true, pending = math.nan, []
    for k in range(750):
        true = plant.apply(tip.step(math.nan).u)
        if k % every == 0:
            pending.append((k + every, true + 3.0, tip.state().time_s))
        while pending and pending[0][0] <= k:
            _, y, taken = pending.pop(0)
            tip.measure(y, taken)
    assert not tip.state().stopped
    assert true + 3.0 == pytest.approx(50.0, abs=0.3)


@kinds
def test_a_gap_is_bridged_as_long_as_the_settings_say(kind: str) -> None:
    tip = controller_for(PLAY, kind, estimator={"sensor": "intermittent", "longest_gap_s": 2.0})
    tip.measure(PLAY.y_rest, 0.0)
    tip.set_target(50.0)
    sources = [tip.step(math.nan).source for _ in range(round(4.5 / tip.dt))]
    bridged = round(2.0 / tip.dt)
    assert set(sources[:bridged]) == {Source.CONTROLLER}
    assert sources[-1] is Source.STOP


@settings(max_examples=15, deadline=None)
@given(st.integers(2, 20))
def test_a_derivative_sees_the_slope_between_two_frames(every: int) -> None:
    """Frames of a steady ramp of 2 deg/s: the derivative takes its gain times that slope, and keeps it in between."""
    gains = {"kp_per_deg": 0.0, "ki_per_deg_s": 0.0, "kd_s_per_deg": 0.01, "filter_s": 0.0, "dead_zone_deg": 0.0}
    tip = controller_for(PLAY, "pid", **FRAMES, gains=gains)
    tip.reset(PLAY.y_rest, 3.0)
    sent = []
    for k in range(5 * every):
        sent.append(tip.step(math.nan).u)
        if (k + 1) % every == 0:
            tip.measure(PLAY.y_rest + 2.0 * (k + 1) * tip.dt, (k + 1) * tip.dt)
    assert sent == pytest.approx([3.0 if k < every else 2.98 for k in range(5 * every)])


def test_a_frame_is_compared_with_what_was_due_when_it_was_taken() -> None:
    """On a device that is its model, late frames leave the feedback nothing to do while the reference moves."""
    alone, fed, plant = controller_for(PLAY, "inverse"), controller_for(PLAY, "inverse_pid", **FRAMES), plant_for()
    y, late = plant.reset(), round(0.2 / PLAY.predictor.dt)
    for tip in (alone, fed):
        tip.reset(y)
        tip.set_reference(lambda t: PLAY.y_rest + 10.0 * (1.0 - np.cos(t)))
    seen, off, moved = [y], [], []
    for k in range(150):
        u = alone.step(seen[-1]).u
        off.append(fed.step(math.nan).u - u)
        moved.append(u)
        seen.append(plant.apply(u))
        if k > late and k % late == 0:
            fed.measure(seen[k + 1 - late], (k + 1 - late) * fed.dt)
    assert np.ptp(moved) > 1.0
    assert np.max(np.abs(off)) < 0.01


def test_a_pid_without_a_sensor_is_refused_in_one_line() -> None:
    for kind in ("pid", "inverse_pid"):
        with pytest.raises(ConfigError, match="expected continuous or intermittent"):
            parse_controller({"kind": kind, "estimator": {"sensor": "none"}}, "controller")

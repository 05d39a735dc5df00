"""Laws of references that are left in mid-motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.planner.reference import PiecewiseReference, Reference, rest_reference, waypoint_request
from hystmpc.ctrl.planner.reference import given_request as preview
from hystmpc.trajectories.motion import Kinematics, MotionLimits, PiecewiseCubic
from hystmpc.trajectories.ruckig_ import move_to_rest
from hystmpc.trials.errors import ControllerError

LIMITS = MotionLimits(velocity_deg_s=30.0, acceleration_deg_s2=200.0, jerk_deg_s3=3000.0)
DT = 0.04

angles = st.floats(-200.0, 200.0)
starts = st.builds(Kinematics, angles, st.floats(-60.0, 60.0), st.floats(-400.0, 400.0))


def motion_of(start: Kinematics, target: float, at: float = 1.0) -> Reference:
    return waypoint_request([target], [0.0], LIMITS)(start, at)


@given(starts, angles)
@settings(max_examples=200)
def test_motion_starts_in_the_given_state_and_ends_at_rest_at_the_target(start: Kinematics, target: float) -> None:
    reference = motion_of(start, target)
    first, last = reference.motion(1.0), reference.motion(reference.end_s)
    unit = max(1.0, abs(target - start.theta_deg))
    assert first.theta_deg == pytest.approx(start.theta_deg, abs=1e-9 * unit)
    assert first.velocity_deg_s == pytest.approx(start.velocity_deg_s, abs=1e-6)
    assert (last.theta_deg, last.velocity_deg_s, last.acceleration_deg_s2) == (target, 0.0, 0.0)
    before_end = reference.motion(reference.end_s - 1e-9)
    assert before_end.theta_deg == pytest.approx(target, abs=1e-6 * unit)


@given(angles, angles, angles, st.floats(0.0, 1.0))
@settings(max_examples=100)
def test_retargeting_in_mid_motion_is_smooth_and_keeps_the_limits(a: float, b: float, c: float, share: float) -> None:
    assume(a == b or abs(a - b) > 1e-6)  # nearer targets are snapped together, and the little motion with them
    first = motion_of(Kinematics(a), b, 0.0)
    turn = share * first.end_s
    assume(turn in {0.0, first.end_s} or abs(first.motion(turn).theta_deg - c) > 1e-6)
    second = motion_of(first.motion(turn), c, turn)
    t = np.arange(turn, second.end_s + 0.01, 1e-3)
    joined = np.concatenate([first.at(np.arange(0.0, turn, 1e-3)), second.at(t)])
    speed = np.diff(joined) / 1e-3
    assert np.max(np.abs(second.motion(turn).theta_deg - first.motion(turn).theta_deg)) <= 1e-9
    assert second.motion(turn).velocity_deg_s == pytest.approx(first.motion(turn).velocity_deg_s, abs=1e-6)
    assert second.motion(turn).acceleration_deg_s2 == pytest.approx(first.motion(turn).acceleration_deg_s2, abs=1e-4)
    bends = np.diff(second.at(t), 2) / 1e-6
    assert np.max(np.abs(speed), initial=0.0) <= LIMITS.velocity_deg_s + 2.0 * LIMITS.acceleration_deg_s2 * 1e-3
    assert np.max(np.abs(bends), initial=0.0) <= LIMITS.acceleration_deg_s2 + LIMITS.jerk_deg_s3 * 2e-3 + 1e-3


def test_a_state_beyond_the_limits_is_braked_first() -> None:
    segments = move_to_rest(Kinematics(0.0, 100.0, 0.0), 5.0, LIMITS)
    motion = PiecewiseReference(segments, 5.0, 0.0)
    assert motion.motion(0.0).velocity_deg_s == pytest.approx(100.0)
    assert abs(motion.motion(0.5 * motion.end_s).velocity_deg_s) <= LIMITS.velocity_deg_s * (1 + 1e-9)


def test_waypoints_rest_for_their_holds_and_stay_at_the_last() -> None:
    reference = waypoint_request([10.0, 10.0, 5.0], [0.5, 0.25, 0.0], LIMITS)(Kinematics(0.0), 2.0)
    t = np.arange(2.0, reference.end_s + 1.0, 1e-3)
    values = reference.at(t)
    assert np.sum(np.abs(values - 10.0) < 1e-9) == pytest.approx(750, abs=3)
    assert np.all(values[t >= reference.end_s] == 5.0)
    assert reference.at(np.array([0.0]))[0] == 0.0  # before it starts it rests


def test_a_move_to_where_it_rests_takes_no_time() -> None:
    assert motion_of(Kinematics(7.0), 7.0).end_s == 1.0
    assert rest_reference(7.0, 3.0).at(np.array([0.0, 9.0])).tolist() == [7.0, 7.0]


def test_arrays_hold_their_last_angle_and_scalar_functions_are_taken_one_by_one() -> None:
    array = preview([1.0, 2.0, 4.0], DT, LIMITS)(Kinematics(0.0), 1.0)
    np.testing.assert_allclose(array.at(1.0 + DT * np.arange(1, 6)), [1, 2, 4, 4, 4])
    assert array.end_s == pytest.approx(1.0 + 3 * DT)
    sine = preview(lambda t: 40.0 + 10.0 * math.sin(t), DT, LIMITS)(Kinematics(0.0), 1.0)
    np.testing.assert_allclose(sine.at(np.array([1.0, 2.0])), [40.0, 40.0 + 10.0 * math.sin(1.0)])
    assert sine.end_s == math.inf


def test_a_target_replaces_a_function_from_its_own_speed() -> None:
    sine = preview(lambda t: 40.0 + 10.0 * np.sin(t), DT, LIMITS)(Kinematics(0.0), 0.0)
    now = sine.motion(2.0)
    assert now.theta_deg == pytest.approx(40.0 + 10.0 * math.sin(2.0))
    assert now.velocity_deg_s == pytest.approx(10.0 * math.cos(2.0), abs=0.3)
    assert preview(np.array([0.0, 90.0]), DT, LIMITS)(now, 0.0).motion(2 * DT).velocity_deg_s == LIMITS.velocity_deg_s


@pytest.mark.parametrize(
    ("source", "text"),
    [
        ([], "expected \\(T,\\)"),
        ([1.0, math.nan], "finite angles"),
        ("up", "expected a callable or angles"),
        (lambda t: "up", "the callable answers ValueError"),
        (lambda t: math.inf, "the callable answers"),
        (lambda a, b: 1.0, "the callable answers TypeError"),
    ],
)
def test_nonsense_is_refused_when_it_is_set(source: object, text: str) -> None:
    with pytest.raises(ControllerError, match=text):
        preview(source, DT, LIMITS)


@pytest.mark.parametrize(
    ("targets", "holds"), [([], []), ([1.0], []), ([math.nan], [0.0]), ([1.0], [-1.0]), ([1e9], [0.0])]
)
def test_impossible_waypoints_are_refused(targets: list[float], holds: list[float]) -> None:
    with pytest.raises(ControllerError, match="waypoints: got"):
        waypoint_request(targets, holds, LIMITS)


@pytest.mark.parametrize(("distance", "velocity", "acceleration", "jerk"), [(0.4, 2, 20, 200), (0.8, 3, 10, 50)])
def test_limits_that_are_whole_multiples_of_a_move_are_no_trap(
    distance: float, velocity: float, acceleration: float, jerk: float
) -> None:
    """ruckig itself finds no motion for these round numbers."""
    limits = MotionLimits(velocity_deg_s=velocity, acceleration_deg_s2=acceleration, jerk_deg_s3=jerk)
    for way in (distance, -distance):
        path = PiecewiseCubic(move_to_rest(Kinematics(2.4), 2.4 + way, limits))
        assert path(path.duration_s) == pytest.approx(2.4 + way, abs=1e-6)

"""Jerk-limited moves: limits are never exceeded, targets are met, odd cases are harmless."""

from __future__ import annotations

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.trajectories import MotionLimits, PointToPoint, random_point_to_point, sample
from hystmpc.trajectories.motion import Kinematics, PiecewiseCubic, end_state
from hystmpc.trajectories.ruckig_ import move
from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

LIMITS = MotionLimits(60.0, 300.0, 3000.0)
ANGLE = st.floats(-120, 120)
ANY_LIMITS = st.builds(
    MotionLimits,
    st.floats(-1, 3).map(lambda x: 10**x),
    st.floats(-1, 4).map(lambda x: 10**x),
    st.floats(0, 6).map(lambda x: 10**x),
)


def rest_to_rest(start: float, target: float, limits: MotionLimits) -> PiecewiseCubic:
    """The pieces of one move."""
    return PointToPoint(start_deg=start, targets_deg=(target,), holds_s=(0.0,), limits=limits).path


def derivative(path: PiecewiseCubic, t: Vec | float, order: int) -> Vec:
    """Velocity (order 1), acceleration (2) or jerk (3) at `t` [s]; at a knot that of the later piece."""
    knots = np.concatenate(([0.0], np.cumsum(path.segments[:, 0])))
    piece = np.minimum(np.searchsorted(knots, t, side="right") - 1, len(path.segments) - 1)
    s, (_, _, v, a, j) = np.minimum(t, path.duration_s) - knots[piece], path.segments[piece].T
    return [v + s * (a + s * j / 2), a + s * j, j + 0 * s][order - 1]


def check_limits(path: PiecewiseCubic | PointToPoint, limits: MotionLimits) -> None:
    """Analytic derivatives on a grid, and at both ends of every piece."""
    t = np.linspace(0, path.duration_s, 4001)
    pieces = path if isinstance(path, PiecewiseCubic) else path.path
    knots = np.cumsum(pieces.segments[:, 0])
    t = np.concatenate((t, knots, np.nextafter(knots, 0)))
    bounds = (limits.velocity_deg_s, limits.acceleration_deg_s2, limits.jerk_deg_s3)
    for order, bound in enumerate(bounds, start=1):
        assert np.abs(derivative(pieces, t, order)).max() <= bound * (1 + 1e-9)


def check_joints(pieces: PiecewiseCubic, limits: MotionLimits) -> None:
    """Angle, velocity and acceleration go on from piece to piece."""
    bounds = np.array([1.0, limits.velocity_deg_s, limits.acceleration_deg_s2])
    for row, following in zip(pieces.segments, pieces.segments[1:], strict=False):
        np.testing.assert_allclose(np.array(end_state(row)) / bounds, following[1:4] / bounds, atol=1e-7)


@settings(max_examples=150, deadline=None)
@given(start=ANGLE, exponent=st.floats(-9, 2), sign=st.sampled_from([-1, 1]), limits=ANY_LIMITS)
def test_moves_of_any_size_keep_any_limits(start: float, exponent: float, sign: int, limits: MotionLimits) -> None:
    target = start + sign * 10**exponent
    path = rest_to_rest(start, target, limits)
    check_limits(path, limits)
    check_joints(path, limits)
    values = path(np.linspace(0, path.duration_s, 500))
    slack = 1e-9 * abs(target - start) + 1e-13 * (1 + abs(start))
    assert values.min() >= min(start, target) - slack
    assert values.max() <= max(start, target) + slack
    assert path(path.duration_s) == target


@settings(max_examples=60, deadline=None)
@given(
    start=ANGLE,
    targets=st.lists(ANGLE | st.sampled_from([0.0, 30.0, 30.0 + 1e-9, 30.0 + 4e-15]), min_size=1, max_size=6),
    hold_s=st.floats(0.01, 3),
    limits=ANY_LIMITS,
)
def test_sequences_keep_limits_and_hold_every_target(
    start: float, targets: list[float], hold_s: float, limits: MotionLimits
) -> None:
    motion = PointToPoint(start, targets, [hold_s] * len(targets), limits)
    check_limits(motion, limits)
    check_joints(motion.path, limits)
    assert motion(motion.duration_s) == pytest.approx(targets[-1], abs=1e-9)
    # While holding, the reference does not move at all.
    resting = motion(motion.duration_s - np.linspace(0, hold_s * 0.99, 50))
    assert np.ptp(resting) == 0


@pytest.mark.parametrize("distance", [-1.1386e-8, -1e-10, 250.0])
@pytest.mark.parametrize("limits", [MotionLimits(9.62, 9.4755, 3.6017e6), MotionLimits(0.01, 1e5, 1e7)])
def test_moves_that_ruckig_drops_or_refuses_in_other_units(distance: float, limits: MotionLimits) -> None:
    pieces = PiecewiseCubic(move(Kinematics(0.0), Kinematics(distance), limits))
    check_limits(pieces, limits)
    assert pieces(pieces.duration_s) == pytest.approx(distance, rel=1e-8)


@pytest.mark.parametrize(("start", "target"), [(30.0, 75.0), (75.0, 30.0), (30.0, 30.5)])
def test_agrees_with_ruckig_evaluated_by_itself(start: float, target: float) -> None:
    wanted, planned = ruckig.InputParameter(1), ruckig.Trajectory(1)
    wanted.current_position, wanted.target_position = [start], [target]
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = [60.0], [300.0], [3000.0]
    ruckig.Ruckig(1).calculate(wanted, planned)
    path = rest_to_rest(start, target, LIMITS)
    assert path.duration_s == pytest.approx(planned.duration, rel=1e-9)
    for t in np.linspace(0, planned.duration, 40):
        position, velocity, acceleration = (x[0] for x in planned.at_time(float(t)))
        assert path(t) == pytest.approx(position, abs=1e-8)
        assert derivative(path, float(t), 1) == pytest.approx(velocity, abs=1e-6)
        assert derivative(path, float(t), 2) == pytest.approx(acceleration, abs=1e-4)


def test_duration_of_a_move_that_reaches_every_limit() -> None:
    # d/v + v/a + a/j: the seven-phase profile.
    assert rest_to_rest(0, 45, LIMITS).duration_s == pytest.approx(45 / 60 + 60 / 300 + 300 / 3000, rel=1e-12)


def test_duration_of_a_move_limited_by_jerk_alone() -> None:
    # Four phases of (d / 2j)^(1/3).
    assert rest_to_rest(0, 0.01, LIMITS).duration_s == pytest.approx(4 * (0.01 / 6000) ** (1 / 3), rel=1e-9)


def test_there_and_back_mirror_each_other() -> None:
    there, back = rest_to_rest(30, 80, LIMITS), rest_to_rest(80, 30, LIMITS)
    t = np.linspace(0, there.duration_s, 200)
    np.testing.assert_allclose(there(t) + back(t), 110, atol=1e-10)


def test_derivatives_are_those_of_the_angle() -> None:
    motion = PointToPoint(30, [60, 40], [0.1, 0.2], LIMITS)
    t = np.linspace(0.01, motion.duration_s - 0.01, 700)
    step = 1e-5
    for order, tolerance in ((1, 1e-4), (2, 0.1)):
        lower = motion if order == 1 else lambda x: derivative(motion.path, x, 1)
        np.testing.assert_allclose(
            (lower(t + step) - lower(t - step)) / (2 * step), derivative(motion.path, t, order), atol=tolerance
        )


def test_equal_targets_add_their_holds_only() -> None:
    once = PointToPoint(30, [60], [1.0], LIMITS)
    thrice = PointToPoint(30, [60, 60, 60 + 1e-14], [0.25, 0.25, 0.5], LIMITS)
    assert thrice.duration_s == pytest.approx(once.duration_s, rel=1e-12)
    assert np.ptp(thrice(np.linspace(thrice.duration_s - 0.999, thrice.duration_s, 300))) == 0
    assert PointToPoint(30, [30], [2.0]).duration_s == 2.0


def test_equal_seeds_give_equal_motions() -> None:
    first, again, other = (random_point_to_point(s, start_deg=30, range_deg=(30, 90), moves=6) for s in (5, 5, 6))
    assert first == again
    assert first != other
    np.testing.assert_array_equal(sample(first, 100)[1], sample(again, 100)[1])
    assert all(30 <= x <= 90 for x in first.targets_deg)
    assert all(1 <= x <= 5 for x in first.holds_s)
    assert random_point_to_point(np.random.default_rng(5), start_deg=30, range_deg=(30, 90), moves=6) == first


def test_a_move_can_be_given_its_duration() -> None:
    pieces = move(Kinematics(30), Kinematics(60), LIMITS, 2.5)
    assert pieces[:, 0].sum() == pytest.approx(2.5, rel=1e-12)
    check_limits(PiecewiseCubic(pieces), LIMITS)
    with pytest.raises(TrajectoryError, match=r"got 0\.1 s, expected at least 0\.8 s within 60 deg/s"):
        move(Kinematics(30), Kinematics(60), LIMITS, 0.1)


def test_an_acceleration_cannot_be_reached_on_no_distance() -> None:
    with pytest.raises(TrajectoryError, match="both 30 deg"):
        move(Kinematics(30), Kinematics(30, 0.0, 5.0), LIMITS)


def test_an_acceleration_beyond_the_limit_is_refused() -> None:
    with pytest.raises(TrajectoryError, match="move from 30 to 60 deg: ruckig finds none"):
        move(Kinematics(30), Kinematics(60, 0.0, -400.0), LIMITS)


@pytest.mark.parametrize(
    ("start", "targets", "holds", "said"),
    [
        (30, [60], [], "1 targets and 0 holds"),
        (30, [], [], "at least 1"),
        (30, [np.inf], [1], r"targets_deg\.0: .*got inf"),
        (np.nan, [40], [1], "start_deg: .*got nan"),
        (30, [40, 50], [1, -1], r"holds_s\.1: .*got -1"),
        (30, [30, 30], [0, 0], "motion of no duration"),
    ],
)
def test_impossible_motions_are_refused(start: float, targets: list[float], holds: list[float], said: str) -> None:
    with pytest.raises(TrajectoryError, match=said):
        PointToPoint(start, targets, holds, LIMITS)


def test_limits_must_be_positive() -> None:
    with pytest.raises(TrajectoryError, match=r"jerk_deg_s3: .*greater than 0, got 0"):
        MotionLimits(10, 10, 0)

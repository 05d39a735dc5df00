"""Laws of the motions in the plane: ends at rest, continuity, limits along lines; and moves of two axes together."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trajectories.config import PLANE_MOTIONS
from hystmpc.trajectories.motion import Kinematics, MotionLimits
from hystmpc.trajectories.plane import (
    PlaneMotion,
    after_approach,
    circle,
    lissajous,
    raster,
    ring,
    spiral,
    star,
    through_points,
    through_tips,
)
from hystmpc.trajectories.ruckig_ import move_together
from hystmpc.trajectories.tissue import TissueMotion, on_tissue
from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.tip import tip_from_angles

LIMITS = MotionLimits(velocity_deg_s=30.0, acceleration_deg_s2=200.0, jerk_deg_s3=2000.0)
MOTIONS = {
    "circle": circle((1.0, 2.0), 10.0, 4.0, 2.0),
    "spiral": spiral((0.0, 0.0), 12.0, 4.0),
    "lissajous": lissajous((0.0, 1.0), (10.0, 6.0), (2, 3), 8.0),
    "star": star((3.0, 0.0), 12.0, limits=LIMITS),
    "ring": ring((0.0, 0.0), 12.0, 6, limits=LIMITS),
    "raster": raster((-8.0, -4.0), (8.0, 4.0), 4, limits=LIMITS),
}
BEATING = TissueMotion((3.0, -1.0), 3.7, (0.8, 0.5), 80.0)
MOTIONS |= {f"{name} on tissue": on_tissue(MOTIONS[name], BEATING) for name in ("circle", "ring")}


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_motion_begins_and_ends_at_rest_and_has_no_jump(motion: PlaneMotion) -> None:
    t = np.linspace(-0.5, motion.duration_s + 0.5, 4000)
    angles = motion(t)
    assert angles.shape == (4000, 2)
    speed = np.hypot(*np.diff(angles, axis=0).T) / np.diff(t)
    assert speed[0] == speed[-1] == 0
    assert speed.max() < 100
    assert np.abs(np.diff(speed)).max() < 8.0
    np.testing.assert_array_equal(motion(0.3), motion(np.array([0.3]))[0])


@given(st.floats(0, 60), st.floats(0.5, 9), st.floats(20, 200))
def test_tissue_moves_periodically_between_rest_and_its_greatest_shift(t: float, breath: float, rate: float) -> None:
    breathing, beating = TissueMotion((2.0, -1.0), breath), TissueMotion((0, 0), 4.0, (0.5, 0.0), rate)
    for motion, period, size in ((breathing, breath, (2.0, -1.0)), (beating, 60 / rate, (0.5, 0.0))):
        np.testing.assert_allclose(motion(t + period), motion(t), atol=1e-6)
        np.testing.assert_allclose(motion(0.0), 0.0, atol=1e-15)
        share = motion(t) / np.where(np.array(size) == 0, 1.0, size)
        assert np.all((share >= 0) & (share <= 1))
    np.testing.assert_allclose(breathing(breath / 2), (2.0, -1.0))


def test_a_target_on_tissue_is_the_target_and_the_tissue() -> None:
    moved, still = MOTIONS["ring on tissue"], MOTIONS["ring"]
    t = np.linspace(1.0, still.duration_s - 1.0, 500)
    np.testing.assert_allclose(moved(t), still(t) + BEATING(t), atol=1e-12)
    block = {"kind": "ring", "centre": [0, 0], "radius": 12, "targets": 6}
    tissue = {"breathing": [3, -1], "breath_s": 3.7, "heartbeat": [0.8, 0.5], "beats_per_min": 80}
    settings = PLANE_MOTIONS["ring"]
    motions = [settings.parse(block | more, "motion").build() for more in ({"tissue": tissue}, {})]
    np.testing.assert_allclose(motions[0](3.0), motions[1](3.0) + BEATING(3.0), atol=1e-12)
    with pytest.raises(TrajectoryError, match="positive breath_s"):
        TissueMotion((1.0, 0.0), 0.0)


@pytest.mark.parametrize("name", ["star", "ring", "raster"])
def test_lines_are_within_the_limits(name: str) -> None:
    motion = MOTIONS[name]
    t = np.linspace(0.0, motion.duration_s, 20001)
    speed = np.hypot(*np.diff(motion(t), axis=0).T) / np.diff(t)
    assert speed.max() <= LIMITS.velocity_deg_s * 1.001


def test_a_star_has_all_its_tips_on_its_circle_and_straight_lines() -> None:
    motion = star((0.0, 0.0), 10.0, 5, hold_s=0.5)
    angles = motion(np.linspace(0, motion.duration_s, 5000))
    radius = np.hypot(*angles.T)
    inner = 10.0 * math.cos(2 * math.pi / 5)
    assert radius.max() == pytest.approx(10.0)
    assert radius.min() == pytest.approx(inner, abs=0.01)


def test_points_that_stay_are_passed_over() -> None:
    motion = through_points([(0, 0), (0, 0), (3, 4)], 0.2, LIMITS)
    np.testing.assert_allclose(motion(motion.duration_s), [3, 4])


speeds = st.floats(-20, 20)


@given(st.lists(st.floats(-50, 50), min_size=4, max_size=4), st.lists(speeds, min_size=2, max_size=2))
def test_axes_that_move_together_arrive_together(places: list[float], first: list[float]) -> None:
    starts = [Kinematics(places[i], first[i]) for i in range(2)]
    moves = move_together(starts, places[2:], LIMITS)
    ends = [float(segments[:, 0].sum()) for segments in moves]
    assert ends[0] == pytest.approx(ends[1], rel=1e-5, abs=1e-9)


@pytest.mark.parametrize(
    "make",
    [
        lambda: circle((0, 0), -1.0, 4.0),
        lambda: circle((0, math.nan), 1.0, 4.0),
        lambda: spiral((0, 0), 1.0, 0.0),
        lambda: star((0, 0), 5.0, tips=2),
        lambda: through_points([(0, 0)], 0.1),
        lambda: through_points([(0, 0), (1, math.inf)], 0.1),
    ],
)
def test_motions_that_make_no_sense_are_refused_in_a_line(make: object) -> None:
    with pytest.raises(TrajectoryError) as refused:
        make()  # type: ignore[operator]
    assert len(str(refused.value)) <= 300


@given(st.floats(1.0, 15.0), st.floats(30.0, 90.0))
def test_a_motion_in_mm_is_followed_by_the_tip(radius_mm: float, length_mm: float) -> None:
    wanted = circle((1.0, -2.0), radius_mm, 3.0)
    motion, t = through_tips(wanted, length_mm), np.linspace(-1.0, 5.0, 40)
    np.testing.assert_allclose(tip_from_angles(motion(t), length_mm)[:, :2], wanted(t), atol=1e-6)
    assert motion.duration_s == wanted.duration_s


@pytest.mark.parametrize(("radius_mm", "length_mm"), [(30.0, 40.0), (5.0, 0.0), (5.0, float("nan"))])
def test_a_motion_out_of_reach_is_refused_in_a_line(radius_mm: float, length_mm: float) -> None:
    with pytest.raises(TrajectoryError, match="expected") as refused:
        through_tips(circle((0.0, 0.0), radius_mm, 3.0), length_mm)
    assert len(str(refused.value)) <= 300


@given(st.floats(-30, 30), st.floats(-30, 30))
def test_an_approach_leads_from_the_rest_to_the_start_in_whole_samples(x: float, y: float) -> None:
    motion = star((0.0, 0.0), 10.0)
    led = after_approach(motion, (x, y), 0.04)
    lead_s = led.duration_s - motion.duration_s
    assert lead_s / 0.04 == pytest.approx(round(lead_s / 0.04))
    np.testing.assert_allclose(led(0.0), [x, y])
    np.testing.assert_allclose(led(lead_s - 1e-6), motion(0.0), atol=1e-6)
    t = np.linspace(0.0, motion.duration_s, 50)
    np.testing.assert_allclose(led(lead_s + t), motion(t), atol=1e-9)


PLANE = {
    "circle": {"centre": [0, 1], "radius": 9, "period_s": 3},
    "spiral": {"centre": [0, 1], "radius": 9, "period_s": 3},
    "lissajous": {"centre": [0, 1], "sizes": [5, 8], "period_s": 6},
    "points": {"points": [[0, 0], [5, 5], [-3, 2]]},
    "star": {"centre": [0, 1], "radius": 9},
    "ring": {"centre": [0, 1], "radius": 9, "targets": 4},
    "raster": {"corner": [-5, -5], "far_corner": [5, 5]},
}


@pytest.mark.parametrize("kind", PLANE_MOTIONS)
def test_every_kind_of_a_settings_file_is_drawn_in_deg_and_in_mm(kind: str) -> None:
    settings = PLANE_MOTIONS[kind].parse({"kind": kind, **PLANE[kind]})
    motion, tips = settings.build(), PLANE_MOTIONS[kind].parse({"kind": kind, **PLANE[kind], "length_mm": 50}).build()
    t = np.linspace(0.0, motion.duration_s, 30)
    assert motion(t).shape == (30, 2)
    np.testing.assert_allclose(tip_from_angles(tips(tips.duration_s), 50.0)[:2], motion(motion.duration_s), atol=1e-6)


@pytest.mark.parametrize("kind", ["points", "star", "ring", "raster"])
def test_limits_are_of_the_angles_in_mm_too(kind: str) -> None:
    """A nearly straight device: the way of its tip is half its length for a rad, so both motions take the same time."""
    length_mm, share = 60.0, math.radians(30.0)
    small = {
        key: np.multiply(v, 0.05).tolist() if key not in ("targets", "tips") else v for key, v in PLANE[kind].items()
    }
    tips = {key: np.multiply(v, share).tolist() if key not in ("targets", "tips") else v for key, v in small.items()}
    angles = PLANE_MOTIONS[kind].parse({"kind": kind, **small}).build()
    motion = PLANE_MOTIONS[kind].parse({"kind": kind, **tips, "length_mm": length_mm}).build()
    assert motion.duration_s == pytest.approx(angles.duration_s)
    t = np.linspace(0.0, angles.duration_s, 50)
    np.testing.assert_allclose(motion(t), angles(t), atol=1e-4)

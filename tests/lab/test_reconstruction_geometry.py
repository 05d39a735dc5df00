"""Geometry of the reconstruction: the segment's closed form, and rays that end on the cap and not before or behind."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trials.errors import ConfigError
from hystmpc_lab.reconstruction.geometry import (
    Cap,
    Groove,
    Oct,
    Pattern,
    ReconstructionSettings,
    Segment,
    measured_distance,
    profile,
    rotated,
    surface_distance,
)

SETTINGS = ReconstructionSettings()
SEGMENT = Segment(SETTINGS.segment_length_mm)
ANGLES = st.floats(-31.0, 31.0)
SCANS = st.integers(0, 17).map(lambda k: 15.0 * k)


def in_sphere(point: np.ndarray) -> tuple[float, float]:
    """Distances of a point of the bending plane from the sphere's centre and from the axis [mm]."""
    return math.hypot(point[0], point[1] - SETTINGS.centre_mm), abs(float(point[0]))


def is_free(point: np.ndarray, pattern: Pattern) -> bool:
    """Whether a point lies in the hollow: the smooth sphere and the grooves. Written apart from the rays."""
    rho, r = in_sphere(point)
    radius = SETTINGS.cap.inner_radius_mm
    grooves = [g for g in pattern.grooves if g.edges_mm[0] < r < g.edges_mm[1]]
    return rho < radius + (grooves[0].depth_mm if grooves else 0.0)


def surface_residual(point: np.ndarray, pattern: Pattern) -> float:
    """Distance to the nearest of the surfaces that end the hollow here [mm]."""
    rho, r = in_sphere(point)
    radius = SETTINGS.cap.inner_radius_mm
    inside = [g for g in pattern.grooves if g.edges_mm[0] < r < g.edges_mm[1]]
    found = [abs(rho - radius - g.depth_mm) for g in inside] or [abs(rho - radius)]
    for groove in pattern.grooves:
        if radius - 1e-9 <= rho <= radius + groove.depth_mm + 1e-9:
            found += [abs(r - edge) for edge in groove.edges_mm]
    return min(found)


@given(ANGLES, SCANS)
def test_a_ray_ends_on_the_surface(theta: float, rotation: float) -> None:
    pattern = SETTINGS.cap.pattern_at(rotation)
    end = SEGMENT.point(theta, surface_distance(SETTINGS, pattern, theta))
    assert surface_residual(end, pattern) < 1e-9
    space = rotated(end, rotation)
    rho = np.linalg.norm(space - np.array([0.0, 0.0, SETTINGS.centre_mm]))
    assert rho == pytest.approx(in_sphere(end)[0], abs=1e-12)


@given(ANGLES, SCANS)
def test_a_ray_is_free_up_to_its_end_and_not_behind_it(theta: float, rotation: float) -> None:
    pattern = SETTINGS.cap.pattern_at(rotation)
    distance = float(surface_distance(SETTINGS, pattern, theta))
    way = SEGMENT.point(np.full(200, theta), np.linspace(0.0, distance - 1e-6, 200))
    assert all(is_free(point, pattern) for point in way)
    assert not is_free(SEGMENT.point(theta, distance + 1e-6), pattern)


def test_rays_end_on_smooth_parts_bottoms_and_walls() -> None:
    pattern, theta = SETTINGS.cap.pattern("I"), np.linspace(0.0, 31.0, 4001)
    ends = SEGMENT.point(theta, surface_distance(SETTINGS, pattern, theta))
    rho = np.hypot(ends[:, 0], ends[:, 1] - SETTINGS.centre_mm)
    smooth, bottom = np.isclose(rho, 30.0), np.isclose(rho, 31.0)
    wall = ~smooth & ~bottom
    assert min(smooth.sum(), bottom.sum(), wall.sum()) > 40
    outer = np.array([groove.edges_mm[1] for groove in pattern.grooves])
    assert np.abs(ends[wall, :1] - outer).min(axis=1) == pytest.approx(0.0, abs=1e-9)  # rays run outwards


@given(ANGLES)
def test_left_and_right_are_alike(theta: float) -> None:
    for pattern in SETTINGS.cap.patterns:
        there, back = surface_distance(SETTINGS, pattern, [theta, -theta])
        assert there == pytest.approx(back, abs=1e-12)


def test_the_smooth_pattern_by_hand() -> None:
    assert surface_distance(SETTINGS, SETTINGS.cap.pattern("II"), 0.0) == pytest.approx(6.0, abs=1e-12)
    t, length = math.radians(30.0), 54.75
    q = np.array([length * (1 - math.cos(t)) / t, length * math.sin(t) / t - (length + 6.0 - 30.0)])
    e = np.array([math.sin(t), math.cos(t)])
    roots = np.roots([1.0, 2 * q @ e, q @ q - 30.0**2])
    assert surface_distance(SETTINGS, SETTINGS.cap.pattern("II"), 30.0) == pytest.approx(max(roots.real), rel=1e-12)


def test_default_distances_and_levers_are_as_documented() -> None:
    theta = np.linspace(0.0, 31.0, 4001)
    for pattern in SETTINGS.cap.patterns:
        distance = surface_distance(SETTINGS, pattern, theta)
        assert 4.2 < distance.min() < distance.max() < 7.0
        lever = SEGMENT.lever(theta, distance)
        assert 0.546 < lever.min() < lever.max() < 0.60


def test_a_straight_tip_is_the_limit_of_a_bent_one() -> None:
    assert SEGMENT.tip(0.0).tolist() == [0.0, 54.75]
    assert SEGMENT.tangent(0.0).tolist() == [0.0, 1.0]
    for theta in (1e-12, 1e-7, 1e-3):
        t = math.radians(theta)
        assert SEGMENT.tip(theta) == pytest.approx([54.75 * (t / 2 - t**3 / 24), 54.75 * (1 - t**2 / 6)], rel=1e-13)
    assert SEGMENT.lever(0.0, 6.0) == pytest.approx(math.radians(54.75 / 2 + 6.0), rel=1e-15)


@given(st.floats(0.01, 90.0))
def test_the_tip_lies_on_the_arc(theta: float) -> None:
    t = math.radians(theta)
    tip = SEGMENT.tip(theta)
    assert tip == pytest.approx([54.75 * 2 * math.sin(t / 2) ** 2 / t, 54.75 * math.sin(t) / t], rel=1e-13)
    radius = 54.75 / t
    assert math.hypot(tip[0] - radius, tip[1]) == pytest.approx(radius, rel=1e-12)


@given(st.floats(-90.0, 90.0), st.floats(0.0, 10.0))
def test_the_lever_is_the_derivative_of_the_point(theta: float, distance: float) -> None:
    h = 1e-4
    difference = SEGMENT.point(theta + h, distance) - SEGMENT.point(theta - h, distance)
    assert SEGMENT.lever(theta, distance) == pytest.approx(np.linalg.norm(difference) / (2 * h), rel=1e-7)


@pytest.mark.parametrize("distance", [5.0, -54.75 / 2])  # the second cancels the part that has no series
def test_the_lever_has_no_step_where_its_series_ends(distance: float) -> None:
    near, far = (SEGMENT.lever(math.degrees(t), distance) for t in (0.01 - 1e-9, 0.01 + 1e-9))
    assert near == pytest.approx(far, rel=1e-6)


def test_the_profile_lies_on_the_surface() -> None:
    for pattern in SETTINGS.cap.patterns:
        line = profile(SETTINGS, pattern)
        assert max(surface_residual(point, pattern) for point in line) < 1e-9
        assert line[-1, 0] == pytest.approx(30.0 * math.sin(math.radians(45.0)))


def test_oct_steps_and_noise() -> None:
    distance = np.linspace(4.0, 7.0, 5001)
    stepped = measured_distance(distance, Oct(noise_mm=0.0, axial_resolution_mm=0.5), np.random.default_rng(0))
    assert set(stepped) == {4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0}
    noisy = measured_distance(distance, Oct(noise_mm=0.02, axial_resolution_mm=0.0), np.random.default_rng(0))
    assert np.std(noisy - distance) == pytest.approx(0.02, rel=0.05)
    ideal = measured_distance(distance, Oct(noise_mm=0.0, axial_resolution_mm=0.0), np.random.default_rng(0))
    assert np.array_equal(ideal, distance)


@pytest.mark.parametrize(
    ("changes", "theta", "message"),
    [
        ({}, [0.0, 50.0], r"the ray at 50 deg misses it: polar angle .* at most that of the rim, 45 deg"),
        ({"cap": {"rim_deg": 31.0}}, [31.0], "misses it"),
        ({}, [0.0, 80.0], "at 80 deg the tip has reached the cap"),
        ({}, [0.0, 91.0], r"got angle 91 deg at sample 1, expected within \+-90 deg"),
        ({"max_angle_deg": 35.0}, [36.0], r"expected within \+-35 deg"),
        ({}, [0.0, math.nan], "got angle nan deg at sample 1"),
    ],
)
def test_a_ray_that_cannot_be_is_refused(changes: dict[str, object], theta: list[float], message: str) -> None:
    settings = ReconstructionSettings.parse(changes)
    with pytest.raises(ConfigError, match=message):
        surface_distance(settings, settings.cap.pattern("II"), theta)


def test_a_distance_beyond_the_range_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"distance 6 mm at sample 1 is beyond the range, expected at most 5 mm"):
        measured_distance(np.array([4.0, 6.0]), Oct(range_mm=5.0), np.random.default_rng(0))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"inner_radius_mm": -1.0}, "inner_radius_mm"),
        ({"radius_mm": 30.0}, "unknown key 'radius_mm'"),
        ({"patterns": [{"name": "I", "grooves": [{"radius_mm": 4.0}, {"radius_mm": 5.0}]}]}, "expected them apart"),
        ({"patterns": [{"name": "I", "grooves": [{"radius_mm": 1.0}]}]}, "rising from 0"),
        ({"patterns": [{"name": "I", "grooves": [{"radius_mm": 21.0}]}]}, "the rim lies at 21.21 mm"),
        ({"patterns": [{"name": "I"}, {"name": "I"}]}, "each name once"),
        ({"sector_deg": 130.0}, "exceed a full turn"),
        ({"patterns": []}, "patterns"),
    ],
)
def test_a_cap_that_cannot_be_is_refused(data: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Cap.parse(data)


@pytest.mark.parametrize("rotation", [-1.0, 270.0, math.nan])
def test_a_rotation_beyond_the_cap_is_refused(rotation: float) -> None:
    with pytest.raises(ConfigError, match=r"expected 0 <= rotation < 270 deg"):
        SETTINGS.cap.pattern_at(rotation)


def test_names_are_looked_up() -> None:
    assert [SETTINGS.cap.pattern_at(r).name for r in (0.0, 89.9, 90.0, 180.0, 255.0)] == ["I", "I", "II", "III", "III"]
    assert SETTINGS.cap.pattern("II").grooves == ()
    with pytest.raises(ConfigError, match="no pattern 'IV', available: I, II, III"):
        SETTINGS.cap.pattern("IV")
    with pytest.raises(ConfigError, match="length"):
        Segment(math.inf)
    assert Groove(radius_mm=4.0).edges_mm == (3.0, 5.0)

"""Maps without memory: printed numbers, limits, round trips, and clear errors where there is no inverse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.maps import (
    S2_TIP_MAP,
    S2_TIP_MAP_SINUSOIDS,
    LaserConversion,
    QuadraticMap,
    TipMap,
)
from hystmpc.trials.errors import FitError, ModelError

MAPS = {"all": S2_TIP_MAP, "sinusoids": S2_TIP_MAP_SINUSOIDS}


@pytest.mark.parametrize(("theta", "x", "y"), [(30, 65.8, 20.5), (60, 54.7, 34.8), (90, 37.0, 43.3)])
def test_tip_of_the_published_coefficients(theta: float, x: float, y: float) -> None:
    assert S2_TIP_MAP(theta) == (pytest.approx(x, abs=0.06), pytest.approx(y, abs=0.06))
    assert S2_TIP_MAP_SINUSOIDS(theta) == (pytest.approx(x, abs=0.7), pytest.approx(y, abs=0.7))


@pytest.mark.parametrize("name", MAPS)
@given(theta=st.floats(0.0, 117.9))
def test_angle_after_tip_is_the_identity(name: str, theta: float) -> None:
    tip = MAPS[name]
    x, y = tip(theta)
    assert float(tip.angle(y)) == pytest.approx(theta, abs=1e-6 if theta < 117 else 1e-4)
    assert float(tip.x.inverse(x)) == pytest.approx(theta, abs=1e-8)


def test_beyond_the_turning_point_there_is_no_angle() -> None:
    assert S2_TIP_MAP.y.turning_deg == pytest.approx(118.47, abs=0.01)
    with pytest.raises(ModelError, match=r"got 46 mm, expected at most 45\.98.* mm, where it turns \(at 118\.5 deg\)"):
        S2_TIP_MAP.angle([30.0, 46.0])
    with pytest.raises(ModelError, match="got nan mm"):
        S2_TIP_MAP.angle(np.nan)


def test_a_straight_map_is_a_quadratic_map() -> None:
    line = QuadraticMap(0.0, 2.0, 1.0)
    np.testing.assert_allclose(line.inverse(line([-3.0, 0.0, 500.0])), [-3.0, 0.0, 500.0])
    assert line.turning_deg == line.turning_mm == math.inf
    with pytest.raises(ModelError, match="b not 0"):
        QuadraticMap(1.0, 0.0, 0.0)


def test_fit_finds_the_map_that_made_the_points() -> None:
    theta = np.linspace(28, 92, 50)
    fitted = TipMap.fit(theta, *S2_TIP_MAP(theta))
    for ours, theirs in ((fitted.x, S2_TIP_MAP.x), (fitted.y, S2_TIP_MAP.y)):
        assert (ours.a, ours.b, ours.c) == pytest.approx((theirs.a, theirs.b, theirs.c), rel=1e-6)


@pytest.mark.parametrize(
    ("theta", "y", "message"),
    [
        ([1.0, 2.0], [1.0], "expected the same"),
        ([1.0, 1.0, 2.0, 2.0], [1.0, 1.0, 2.0, 2.0], "2 different angles, expected at least 3"),
        ([1.0, np.nan, 2.0], [1.0, 1.0, 2.0], "not finite"),
    ],
)
def test_unusable_points(theta: list[float], y: list[float], message: str) -> None:
    with pytest.raises(FitError, match=message):
        QuadraticMap.fit(theta, y)


def test_laser_as_s1_prints_it() -> None:
    """S1: 1 to 3 mm correspond to 2.09 to 6.26 deg."""
    laser = LaserConversion()
    np.testing.assert_allclose(laser.angle([1.0, 3.0]), [2.09, 6.26], atol=0.006)
    assert float(laser.distance(2.0)) == pytest.approx(4.05 * 2 + 29.36)


@given(theta=st.floats(-57.0, 57.0), straight=st.floats(40.0, 100.0))
def test_laser_round_trip(theta: float, straight: float) -> None:
    laser = LaserConversion()
    voltage = laser.voltage(straight - laser.displacement(np.array([0.0, theta])))
    np.testing.assert_allclose(laser.angles_of_group(voltage, straight), [0.0, theta], atol=1e-9)
    if theta > 0:  # then the straight sample is the farthest, as eq. (3) takes it
        np.testing.assert_allclose(laser.angles_of_group(voltage), [0.0, theta], atol=1e-9)


def test_laser_refuses_what_it_cannot_tell() -> None:
    with pytest.raises(ModelError, match=r"got 60 deg, expected at most 57\.29"):
        LaserConversion().displacement(60.0)
    with pytest.raises(ModelError, match="m_mm_per_v"):
        LaserConversion(m_mm_per_v=-1.0)

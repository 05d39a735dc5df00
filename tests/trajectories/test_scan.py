"""Scans: amplitude, frequency, centre, and a lead-in that neither jumps nor overshoots."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.trajectories import MotionLimits, Raster, SinusoidScan, TriangleScan
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.errors import TrajectoryError

LIMITS = MotionLimits(200.0, 3000.0, 60000.0)


def turning_points(trajectory: Trajectory, rate_hz: float = 20000.0) -> tuple[np.ndarray, np.ndarray]:
    """Times and angles where a finely sampled signal turns round."""
    t = np.arange(0, trajectory.duration_s, 1 / rate_hz)
    values = trajectory(t)
    direction = np.sign(np.diff(values))
    moving = np.flatnonzero(direction)
    turns = moving[1:][np.diff(direction[moving]) != 0]
    return t[turns], values[turns]


def scans(start: float, centre: float, cycles: float) -> list[Trajectory]:
    """The same scan in every make."""
    return [
        SinusoidScan(start, centre, 12.0, 0.8, cycles),
        SinusoidScan(start, centre, 12.0, 0.8, cycles, LIMITS),
        TriangleScan(start, centre, 12.0, 0.8, cycles),
        TriangleScan(start, centre, 12.0, 0.8, cycles, LIMITS),
        Raster(start, centre, [12.0], 0.8, cycles),
    ]


@pytest.mark.parametrize("start", [30.0, 48.0, 55.0, 60.0, 65.0, 72.0, 90.0])
def test_amplitude_frequency_and_centre(start: float) -> None:
    for scan in scans(start, 60.0, 3.0):
        cycle_s = 1 / 0.8
        begin_s = scan.duration_s - 3 * cycle_s
        t = np.linspace(begin_s, scan.duration_s, 6001)
        values = scan(t)
        assert values.max() == pytest.approx(72.0, abs=1e-7)
        assert values.min() == pytest.approx(48.0, abs=1e-7)
        assert values[:-1].mean() == pytest.approx(60.0, abs=1e-3)
        np.testing.assert_allclose(scan(t[:2000] + cycle_s), values[:2000], atol=1e-7)
        # Half a period later the scan is on the other side of the centre.
        np.testing.assert_allclose(scan(t[:2000] + cycle_s / 2) - 60, 60 - values[:2000], atol=1e-7)


@settings(max_examples=60, deadline=None)
@given(start=st.floats(0, 120), faster=st.floats(1, 20), amplitude=st.floats(0.01, 40), frequency=st.floats(0.01, 2))
def test_lead_in_goes_straight_to_the_first_turning_point(
    start: float, faster: float, amplitude: float, frequency: float
) -> None:
    omega = 2 * np.pi * frequency
    limits = MotionLimits(*(amplitude * omega**k * faster * (1 + 1e-12) for k in (1, 2, 3)))
    scan = SinusoidScan(start, 60.0, amplitude, frequency, 1.0, limits)
    lead_s = scan.duration_s - 1 / frequency
    values = scan(np.linspace(0, lead_s, 2000))
    assert (np.diff(values) * (1 if start <= 60 else -1) >= -1e-9 * (1 + amplitude)).all()
    assert values[-1] == pytest.approx(60 + (amplitude if start <= 60 else -amplitude), abs=1e-7)


@pytest.mark.parametrize(
    "scan",
    [
        SinusoidScan(30, 60, 12, 0.8, 2),
        SinusoidScan(80, 60, 12, 0.8, 1.5),
        Raster(30, 60, [5, 10, 20], 0.5, 1.5),
        Raster(70, 60, [20, 10, 0.5], 0.5, 2),
    ],
)
def test_sinusoids_are_smooth_to_the_second_derivative(scan: Trajectory) -> None:
    kinks = []
    for n in (20001, 40001):
        t = np.linspace(0, scan.duration_s, n)[:-1]
        acceleration = np.diff(scan(t), 2) / (t[1] - t[0]) ** 2
        kinks.append(np.abs(np.diff(acceleration)).max())
    # A jump of acceleration would stay when the grid is halved.
    assert kinks[1] < 0.6 * kinks[0]


def test_sinusoid_stays_within_its_own_rates() -> None:
    scan, omega = SinusoidScan(10, 60, 12, 0.8, 2), 2 * np.pi * 0.8
    t = np.linspace(0, scan.duration_s, 20001)
    rate = np.diff(scan(t)) / (t[1] - t[0])
    assert np.abs(rate).max() <= 12 * omega * (1 + 1e-9)
    assert np.abs(np.diff(rate) / (t[1] - t[0])).max() <= 12 * omega**2 * (1 + 1e-5)


def test_sharp_triangle_has_one_speed() -> None:
    scan = TriangleScan(30, 60, 12, 0.8, 2)
    rate = np.abs(np.diff(scan(np.linspace(0, scan.duration_s, 3001)))) * 3000 / scan.duration_s
    corners = rate < 4 * 12 * 0.8 * (1 - 1e-9)
    assert corners.sum() <= 5
    np.testing.assert_allclose(rate[~corners], 4 * 12 * 0.8, rtol=1e-9)


@pytest.mark.parametrize("shape", ["sinusoid", "triangle"])
@pytest.mark.parametrize("limits", [None, LIMITS])
@pytest.mark.parametrize("amplitudes", [[4.0, 8.0, 16.0], [16.0, 8.0, 4.0], [6.0, 6.0]])
@pytest.mark.parametrize(("cycles", "start"), [(1.0, 50.0), (1.5, 75.0)])
def test_raster_turns_at_every_amplitude_on_alternating_sides(
    shape: str, limits: MotionLimits | None, amplitudes: list[float], cycles: float, start: float
) -> None:
    raster = Raster(start, 60.0, amplitudes, 0.5, cycles, shape, limits)  # type: ignore[arg-type]
    _, found = turning_points(raster, 2000.0)
    found = np.append(found, raster(raster.duration_s)) - 60.0
    expected = np.repeat(amplitudes, round(2 * cycles) + 1)
    first = 1.0 if start <= 60 else -1.0
    np.testing.assert_allclose(found, first * expected * (-1.0) ** np.arange(expected.size), atol=0.02)


def test_triangle_raster_keeps_its_period() -> None:
    raster = Raster(48.0, 60.0, [12.0, 6.0], 0.5, 2, "triangle", LIMITS)
    t, _ = turning_points(raster)
    np.testing.assert_allclose(np.diff(t), 1.0, atol=2e-3)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"amplitude_deg": 0.0}, r"amplitude_deg: .*greater than 0, got 0\.0"),
        ({"frequency_hz": -1.0}, "frequency_hz: .*greater than 0, got -1.0"),
        ({"cycles": 1.2}, "multiple of 0.5"),
        ({"cycles": 0}, "cycles: .*got 0"),
        ({"start_deg": float("nan")}, "start_deg: .*got nan"),
    ],
)
@pytest.mark.parametrize("kind", [SinusoidScan, TriangleScan])
def test_impossible_scans_are_refused(
    kind: type[SinusoidScan] | type[TriangleScan], changed: dict[str, float], said: str
) -> None:
    good = {"start_deg": 30.0, "centre_deg": 60.0, "amplitude_deg": 10.0, "frequency_hz": 0.5, "cycles": 1.0}
    with pytest.raises(TrajectoryError, match=said):
        kind(**(good | changed))


def test_limits_below_the_scan_are_named() -> None:
    with pytest.raises(TrajectoryError, match="got acceleration_deg_s2 10, expected at least 303"):
        SinusoidScan(30, 60, 12, 0.8, 1, MotionLimits(1000, 10, 1e5))
    with pytest.raises(TrajectoryError, match=r"got 0\.625 s, expected at least"):
        TriangleScan(30, 60, 12, 0.8, 1, MotionLimits(20, 1000, 1e5))


def test_raster_needs_an_amplitude_and_a_known_shape() -> None:
    with pytest.raises(TrajectoryError, match=r"amplitudes_deg: .*at least 1 item"):
        Raster(30, 60, [], 0.5, 1)
    with pytest.raises(TrajectoryError, match=r"shape: .*'sinusoid' or 'triangle', got 'square'"):
        Raster(30, 60, [5], 0.5, 1, "square")  # type: ignore[arg-type]

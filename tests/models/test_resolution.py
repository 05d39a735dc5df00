"""Laws of the resolution: found in any unit, from any offset; none of a continuous sensor; counted in the noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.decades import Decades
from hystmpc.models.identify.estimation_noise import estimation_noise, resolution
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

DT = 0.04
seeds, steps = st.integers(0, 1000), st.floats(0.05, 3.0)


def motion(seed: int, samples: int = 2000) -> Vec:
    """Ramps between random angles with rests at their ends [deg]."""
    random, t = np.random.default_rng(seed), DT * np.arange(samples)
    corners = np.repeat(random.uniform(10.0, 90.0, samples // 100 + 2), 2)
    return np.interp(t, np.cumsum(np.tile([2.8, 1.2], corners.size // 2)), corners)


def rounded(angle: Vec, step: float, offset: float = 0.0) -> Vec:
    return np.round((angle - offset) / step) * step + offset


@settings(max_examples=30)
@given(steps, st.floats(-5.0, 5.0), st.floats(0.0, 2.0), st.floats(-3.0, 3.0), seeds)
def test_steps_are_found_under_noise_of_their_size_in_any_unit_from_any_offset(
    step: float, offset: float, noise: float, decades: float, seed: int
) -> None:
    angle = motion(seed)
    angle += noise * step * np.random.default_rng(seed).standard_normal(angle.size)
    unit = 10.0**decades
    assert resolution([unit * rounded(angle, step, offset)]) == pytest.approx(unit * step, rel=1e-2)


@settings(max_examples=30)
@given(st.floats(0.01, 1.0), seeds)
def test_a_continuous_sensor_has_no_steps(sigma: float, seed: int) -> None:
    angle = motion(seed)
    noisy = angle + sigma * np.random.default_rng(seed).standard_normal(angle.size)
    held = noisy.copy()
    for k in range(20, held.size - 10, 40):
        held[k : k + 6] = held[k]
    assert [resolution([signal]) for signal in (angle, noisy, held)] == [0.0, 0.0, 0.0]


@settings(max_examples=20)
@given(st.floats(0.2, 2.0), st.floats(15.0, 24.0), seeds)
def test_steps_are_found_after_resampling(step: float, rate_hz: float, seed: int) -> None:
    reading, t = rounded(motion(seed), step), DT * np.arange(2000)
    resampled = np.interp(np.arange(0.0, t[-1], 1.0 / rate_hz), t, reading)
    assert resolution([resampled]) == pytest.approx(step, rel=1e-2)


@settings(max_examples=20)
@given(st.floats(0.5, 3.0), st.floats(0.0, 0.03), seeds)
def test_steps_are_found_under_a_little_noise_added_to_them(step: float, noise: float, seed: int) -> None:
    reading = rounded(motion(seed), step)
    reading += noise * step * np.random.default_rng(seed).standard_normal(reading.size)
    assert resolution([reading]) == pytest.approx(step, rel=1e-2)


def test_printed_digits_are_steps_and_nothing_is_none() -> None:
    noisy = motion(3) + 0.1 * np.random.default_rng(3).standard_normal(2000)
    assert resolution([np.round(noisy, 2)]) == pytest.approx(0.01, rel=1e-6)
    assert resolution([np.zeros(5)]) == resolution([np.zeros(0)]) == 0.0


def noise_of(step: float, sigma: float, seed: int) -> NoiseModel:
    """Noise of a perfect model beside a sensor of these steps, with noise before they are taken."""
    angle = motion(seed)
    reading = angle + sigma * np.random.default_rng(seed).standard_normal(angle.size)
    reading = rounded(reading, step) if step else reading
    trial = Trial(DT * np.arange(angle.size), angle / 12.0, reading, source="motion")
    return estimation_noise([trial], [reading - angle])


@settings(max_examples=15, deadline=None)
@given(steps, st.floats(0.0, 1.0), st.integers(0, 20))
def test_steps_are_counted_in_the_noise(step: float, share: float, seed: int) -> None:
    """At rest the error of a reading does not change: no fit of white noise sees it."""
    found = noise_of(step, share * step, seed)
    assert found.sensor_sigma_deg >= step / math.sqrt(12.0) * 0.999
    assert found.sensor_sigma_deg == pytest.approx(math.hypot(share * step, step / math.sqrt(12.0)), rel=0.25)
    if share < 0.2:
        assert found.sensor_resolution_deg == pytest.approx(step, rel=1e-2)


def test_steps_far_below_the_noise_and_a_continuous_sensor_leave_the_noise_as_it_is() -> None:
    fine, plain = noise_of(0.01, 0.15, 4), noise_of(0.0, 0.15, 4)
    assert (fine.sensor_resolution_deg, plain.sensor_resolution_deg) == (0.0, 0.0)
    assert fine.sensor_sigma_deg == pytest.approx(plain.sensor_sigma_deg, rel=0.01)


def test_steps_have_the_unit_of_the_log() -> None:
    decades = Decades(command=1.0, angle=1e-3)
    noise = NoiseModel(
        sensor_sigma_deg=0.3,
        drift_sigma_deg_per_sqrt_s=0.1,
        motion_sigma_deg_per_sqrt_unit=0.1,
        sensor_resolution_deg=0.9,
    )
    assert decades.log_noise(noise).sensor_resolution_deg == pytest.approx(9e-4)

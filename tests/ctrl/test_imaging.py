"""The simulated imaging system: when its frames are taken, when they arrive, and what they show."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.loop import ImageFrame, Imaging, ImagingSettings, NoSensorSettings, Viewer

systems = st.builds(
    ImagingSettings,
    rate_hz=st.floats(0.2, 100.0),
    latency_s=st.floats(0.0, 2.0),
    jitter_s=st.floats(0.0, 0.5),
    dropout_share=st.floats(0.0, 0.9),
    noise_deg=st.floats(0.0, 2.0),
)


def seen(settings: ImagingSettings, seed: int = 0, seconds: float = 4.0, dt: float = 0.04) -> list[list[ImageFrame]]:
    """Frames by sample; the device moves by 10 deg/s."""
    imaging, found = Imaging.at_rest(settings, seed, 30.0), []
    for k in range(1, round(seconds / dt) + 1):
        frames, imaging = imaging.later(k * dt, 30.0 + 10.0 * k * dt)
        found.append(list(frames))
    return found


@settings(max_examples=60, deadline=None)
@given(systems, st.integers(0, 2**31))
def test_a_frame_arrives_after_it_was_taken_in_the_sample_of_its_arrival(system: ImagingSettings, seed: int) -> None:
    by_sample = seen(system, seed)
    taken = [frame.taken_s for frames in by_sample for frame in frames]
    assert len(set(taken)) == len(taken) <= 4.0 * system.rate_hz + 1
    for k, frames in enumerate(by_sample):
        for frame in frames:
            assert frame.taken_s <= frame.arrives_s
            assert k * 0.04 < frame.arrives_s + 1e-9 <= (k + 1) * 0.04 + 1e-8
            assert abs(frame.taken_s * system.rate_hz - round(frame.taken_s * system.rate_hz)) < 1e-6
    assert by_sample == seen(system, seed)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.2, 100.0), st.floats(0.0, 1.0))
def test_without_noise_a_frame_shows_the_device_when_it_was_taken(rate_hz: float, latency_s: float) -> None:
    for frames in seen(ImagingSettings(rate_hz=rate_hz, latency_s=latency_s)):
        for frame in frames:
            assert frame.angle_deg == pytest.approx(30.0 + 10.0 * frame.taken_s)
            assert frame.arrives_s == pytest.approx(frame.taken_s + latency_s)


def test_noise_and_lost_frames_are_as_often_as_the_settings_say() -> None:
    system = ImagingSettings(rate_hz=100, latency_s=0.0, dropout_share=0.3, noise_deg=0.5)
    frames = [frame for found in seen(system, seconds=40.0) for frame in found]
    assert len(frames) == pytest.approx(0.7 * 4000, abs=120)
    errors = [frame.angle_deg - 30.0 - 10.0 * frame.taken_s for frame in frames]
    assert np.std(errors) == pytest.approx(0.5, rel=0.05)
    assert abs(np.mean(errors)) < 0.03


def test_jitter_lets_frames_overtake_each_other_and_the_newest_stays_the_newest() -> None:
    system, taken = ImagingSettings(rate_hz=50, latency_s=0.2, jitter_s=0.1), []
    imaging = Imaging.at_rest(system, 1, 30.0)
    for k in range(1, 200):
        frames, imaging = imaging.later(0.04 * k, 30.0)
        taken += [frame.taken_s for frame in frames]
        assert imaging.newest.taken_s == max([0.0, *taken])
    assert taken != sorted(taken)


def test_no_sensor_shows_the_rest_and_nothing_else() -> None:
    viewer = Viewer(NoSensorSettings(), 0, lambda: 31.0)
    assert viewer.start() == 31.0
    assert viewer.arrived(10.0) == ()

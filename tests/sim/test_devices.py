"""The simulated catheters show what the papers show of theirs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl.loop import Plant
from hystmpc.sim.devices.device import Device
from hystmpc.sim.devices.tendon import TendonCatheter, TendonParameters
from hystmpc.sim.plants.device import DevicePlant
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec
from hystmpc_lab.devices.muscle import MuscleCatheter, MuscleParameters

DT = 0.01
SMOOTH = TendonParameters(roughness=0.0)
STILL = TendonParameters(roughness=0.0, viscous_s_per_mm=0.0, viscoelastic=0.0, drive_lag_s=0.0)
DEVICES: dict[str, Device] = {"tendon": TendonCatheter(), "muscle": MuscleCatheter()}


def run(device: Device, commands: Vec, state: Vec | None = None, dt: float = DT, seed: int = 0) -> tuple[Vec, Vec]:
    """Angles (T,) and state after it."""
    start = device.virgin() if state is None else state
    done = device.advance(start, commands, dt, np.random.default_rng(seed))
    return done.angle, done.state


def wave(frequency: float, peak: float, periods: float = 1.0, dt: float = DT) -> Vec:
    """From 0 to `peak` and back."""
    t = np.arange(round(periods / frequency / dt)) * dt
    return peak / 2 * (1 - np.cos(2 * np.pi * frequency * t))


def loop_width(device: Device, frequency: float, peak: float, at: float, dt: float = DT) -> float:
    """Unloading less loading angle at command `at`, in the second period."""
    u = wave(frequency, peak, 2, dt)
    angle, _ = run(device, u, dt=dt)
    second, half = u.size // 2, u.size // 4
    up, down = slice(second, second + half), slice(second + half, u.size)
    return float(np.interp(at, u[down][::-1], angle[down][::-1]) - np.interp(at, u[up], angle[up]))


@pytest.mark.parametrize("name", DEVICES)
@given(seed=st.integers(0, 100), cut=st.integers(1, 199))
def test_state_is_all_the_memory(name: str, seed: int, cut: int) -> None:
    device, random = DEVICES[name], np.random.default_rng(seed)
    u = np.cumsum(random.normal(0, 0.3, 200)) % device.commands[1]
    start, generator = device.virgin(), np.random.default_rng(seed)
    whole = device.advance(start, u, DT, np.random.default_rng(seed))
    first = device.advance(start, u[:cut], DT, generator)
    rest = device.advance(first.state, u[cut:], DT, generator)
    np.testing.assert_array_equal(np.concatenate([first.angle, rest.angle]), whole.angle)
    np.testing.assert_array_equal(start, device.virgin())


def test_first_flexure_happens_once() -> None:
    """S2: 20 deg at the pretension, about 30 deg after the first flexure, never 20 again."""
    device = TendonCatheter(SMOOTH)
    angle, state = run(device, np.concatenate([np.zeros(100), wave(0.1, 6.0), np.zeros(200)]))
    again, _ = run(device, np.concatenate([wave(0.1, 6.0, 3), np.zeros(200)]), state)
    assert angle[99] == pytest.approx(20.0, abs=0.5)
    assert angle[-1] == pytest.approx(29.5, abs=0.7)
    assert again.min() > 28.5
    assert again[-1] == pytest.approx(angle[-1], abs=0.1)


def test_tendon_loop_lies_between_the_published_lines() -> None:
    p = TendonParameters(roughness=0.0, end_deg=0.0)
    _, state = run(TendonCatheter(p), wave(0.1, 6.0))
    u = wave(0.1, 6.0)
    angle, _ = run(TendonCatheter(p), u, state)
    loading, unloading = p.loading_deg + p.loading_slope * u, p.unloading_deg + p.unloading_slope * u
    assert np.all((angle > loading - 0.5) & (angle < unloading + 0.5))


@given(slower=st.sampled_from([2, 5, 20]), seed=st.integers(0, 50))
def test_without_rate_effects_only_the_path_counts(slower: int, seed: int) -> None:
    turns = np.random.default_rng(seed).uniform(0, 6, 6)
    device = TendonCatheter(STILL)
    ends = [run(device, np.interp(np.linspace(0, 5, 50 * k + 1), np.arange(6), turns))[0][-1] for k in (1, slower)]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


@given(low=st.floats(1.0, 3.0), high=st.floats(3.2, 5.0))
def test_a_minor_loop_closes(low: float, high: float) -> None:
    """Return-point memory: after a minor loop the device is as if it had not been made."""
    device = TendonCatheter(STILL)
    outer = np.concatenate([np.linspace(0, 6, 100), np.linspace(6, low, 100)])
    before, state = run(device, outer)
    after, _ = run(device, np.concatenate([np.linspace(low, high, 50), np.linspace(high, low, 50)]), state)
    assert after[-1] == pytest.approx(before[-1], abs=1e-9)


def test_reversal_is_flat_first_and_smooth_then() -> None:
    """The slope grows from zero through the middle to that of the line, unlike that of one backlash."""
    device = TendonCatheter(STILL)
    down = np.linspace(5.0, 2.0, 301)
    angle, _ = run(device, np.concatenate([np.linspace(0, 5, 500), down]))
    slope = -np.diff(angle[500:]) / 0.01
    assert np.allclose(slope[:18], 0.0, atol=1e-9)
    assert 3.0 < slope[60] < 9.5
    assert slope[-1] == pytest.approx(SMOOTH.unloading_slope, abs=0.3)


def test_amplitude_falls_slightly_with_frequency() -> None:
    """S2 Fig. 5(a): between 0.1 and 0.5 Hz by a small degree; recorded logs show 0.6 to 1 %."""
    device = TendonCatheter(SMOOTH)
    _, state = run(device, wave(0.1, 6.0))
    ranges = [float(np.ptp(run(device, wave(f, 5.0, 2), state)[0])) for f in (0.1, 0.3, 0.5)]
    assert ranges[0] > ranges[1] > ranges[2] > 0.97 * ranges[0]


@pytest.mark.parametrize("name", DEVICES)
def test_a_hold_holds(name: str) -> None:
    """Constant in, constant out, once what follows late has arrived; friction's randomness does not act at rest."""
    device = DEVICES[name]
    move, held = np.linspace(0, 2.0, 100), np.full(1500, 2.0)
    angle, _ = run(device, np.concatenate([move, held]))
    assert np.ptp(angle[100 + 500 :]) < 1e-3
    assert abs(angle[100 + 500] - angle[100 + 50]) < 1.0


def test_muscle_has_a_dead_band_saturates_and_is_asymmetric() -> None:
    """S1 Fig. 4: flat at the bottom, ever less slope towards the top."""
    up, _ = run(MuscleCatheter(), np.linspace(0, 3, 3000))
    at = {p: float(up[round(1000 * p) - 1]) for p in (0.4, 1.0, 1.5, 2.5, 3.0)}
    assert at[0.4] < 0.5
    assert at[1.5] - at[1.0] > 6.0
    assert at[3.0] - at[2.5] < 0.5 * (at[1.5] - at[1.0])


def test_muscle_loop_widens_with_frequency() -> None:
    """S1 sec. II-B: up to 1 Hz."""
    widths = [loop_width(MuscleCatheter(), f, 3.0, 1.3, dt=0.004) for f in (0.05, 0.2, 0.4, 0.8, 1.0)]
    assert widths[0] > 1.0
    assert np.all(np.diff(widths) > 0)


def test_muscle_vents_slower_than_it_fills_near_the_bottom() -> None:
    device = MuscleCatheter()
    rise = device.advance(device.virgin(), np.full(50, 3.0), DT, np.random.default_rng(0))
    full = device.advance(rise.state, np.full(500, 3.0), DT, np.random.default_rng(0))
    fall = device.advance(full.state, np.zeros(50), DT, np.random.default_rng(0))
    assert 3.0 - rise.actuator[-1] < 0.5 * fall.actuator[-1]


@given(u=st.lists(st.floats(-5.0, 20.0), min_size=1, max_size=50), seed=st.integers(0, 9))
@pytest.mark.parametrize("name", DEVICES)
def test_any_command_gives_a_finite_angle_in_range(name: str, u: list[float], seed: int) -> None:
    angle, state = run(DEVICES[name], np.array(u), seed=seed)
    assert np.isfinite(angle).all()
    assert np.isfinite(state).all()
    assert angle.min() > -1.0
    assert angle.max() < 100.0


def test_parameters_out_of_bounds() -> None:
    with pytest.raises(ConfigError, match=r"TendonParameters\.drive_lag_s: got -1 s, expected 0 to 10 s"):
        TendonParameters(drive_lag_s=-1)
    with pytest.raises(ConfigError, match="lines cross"):
        TendonParameters(unloading_deg=22.0)
    with pytest.raises(ConfigError, match=r"MuscleParameters\.friction: got nan"):
        MuscleParameters(friction=float("nan"))


@pytest.mark.parametrize("name", DEVICES)
def test_behind_the_plant_interface(name: str) -> None:
    plant = DevicePlant(DEVICES[name], dt_s=0.04)
    as_plant: Plant = plant
    first = [as_plant.reset(), *(as_plant.apply(u) for u in (0.5, 1.0, 1.5, 1.0))]
    assert first == [plant.reset(), *(plant.apply(u) for u in (0.5, 1.0, 1.5, 1.0))]
    other = plant.reseeded(1)
    assert other.reset() != plant.reset()
    assert abs(first[0] - plant.true_angle) < 0.5
    with pytest.raises(ConfigError, match="dt_s"):
        DevicePlant(DEVICES[name], dt_s=0.0)

"""Laws of the floors: noise is found whatever moves, repeats see noise and not the motion; signs of a sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.logs.noise_floor import find_floor
from hystmpc.gap.logs.sensor import repaired, sensor_signs, white_noise
from hystmpc.trials.trial import Trial

from .motions import DT, KINDS, multisine, sine, trial

SINE = sine(0.2, 40.0)
SEEDS = st.integers(0, 1000)
SIGMAS = st.sampled_from([0.01, 0.05, 0.2, 1.0])


def noise(size: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(size)


@given(SIGMAS, SEEDS)
def test_white_noise_is_known_to_15_percent(sigma: float, seed: int) -> None:
    assert white_noise([sigma * noise(1000, seed)]) == pytest.approx(sigma, rel=0.15)


@given(st.sampled_from([0.1, 0.3, 1.0]), SEEDS, st.floats(0.0, 0.4), st.floats(0.0, 20.0))
def test_white_noise_does_not_see_a_smooth_signal(sigma: float, seed: int, hz: float, height: float) -> None:
    t = np.arange(1000) * DT
    assert white_noise([sigma * noise(1000, seed) + height * np.sin(2 * np.pi * hz * t)]) == pytest.approx(
        sigma, rel=0.15
    )


@given(SEEDS)
def test_white_noise_does_not_see_jumps_and_spikes(seed: int) -> None:
    steps = np.repeat(np.random.default_rng(seed).uniform(0, 50, 20), 50)
    spikes = np.zeros(1000)
    spikes[::100] = 7.0
    assert white_noise([0.1 * noise(1000, seed) + steps + spikes]) == pytest.approx(0.1, rel=0.25)


@settings(max_examples=30)
@given(SIGMAS, SEEDS)
def test_repeats_see_the_noise_and_not_what_comes_again(sigma: float, seed: int) -> None:
    own = trial(SINE)
    again = 3.0 * np.sin(own.command) + 0.2 * own.command**2  # locked to the command: a better simulator would know it
    floor = find_floor([own], [again + sigma * noise(len(own), seed)], DT)
    assert floor.kind == "repeats"
    assert floor.rmse_deg == pytest.approx(sigma, rel=0.15)


def test_repeats_see_what_does_not_come_again_and_noise_does_not() -> None:
    own = trial(SINE)
    heartbeat = 0.5 * np.sin(2 * np.pi * 1.13 * own.t)
    floor = find_floor([own], [heartbeat + 0.05 * noise(len(own))], DT)
    assert floor.rmse_deg > 0.3
    assert floor.noise_deg == pytest.approx(0.05, rel=0.3)


def test_without_repeats_the_floor_is_the_noise() -> None:
    own = trial(multisine())
    floor = find_floor([own], [0.3 * noise(len(own))], DT)
    assert (floor.kind, floor.rmse_deg) == ("noise", floor.noise_deg)


@settings(max_examples=30)
@given(st.sampled_from([0.02, 0.0879, 0.25, 360 / 4096]), st.floats(-5, 5), st.sampled_from([None, 4]))
def test_the_quantisation_step_is_recovered(step: float, offset: float, digits: int | None) -> None:
    own = trial(SINE)
    y = np.round((own.angle + 0.02 * noise(len(own))) / step) * step + offset
    y = y if digits is None else np.round(y, digits)
    signs = sensor_signs([Trial(own.t, own.command, y)])
    assert signs.quantisation_deg == pytest.approx(step, rel=1e-3)


@settings(max_examples=30)
@given(SIGMAS, SEEDS)
def test_a_continuous_angle_is_on_no_grid(sigma: float, seed: int) -> None:
    own = trial(SINE, sigma * noise(SINE.size, seed))
    assert sensor_signs([own]).quantisation_deg == 0


def test_a_coarse_grid_counts_and_decimals_do_not() -> None:
    own = trial(SINE, 0.05 * noise(SINE.size))
    coarse, fine = (Trial(own.t, own.command, np.round(own.angle / q) * q) for q in (0.5, 0.01))
    assert sensor_signs([coarse], 0.05).coarse
    signs = sensor_signs([fine], 0.05)
    assert not any((signs.coarse, signs.noisy, signs.spikes, signs.drops))


def test_more_noise_than_nominal_counts() -> None:
    own = trial(SINE, 0.2 * noise(SINE.size))
    assert sensor_signs([own], 0.1).noisy
    assert not sensor_signs([own], 0.2).noisy
    assert not sensor_signs([own]).noisy


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_spikes_are_counted_and_repaired(kind: str) -> None:
    clean = trial(KINDS[kind][0], 0.05 * noise(KINDS[kind][0].size))
    random = np.random.default_rng(3)
    at = random.choice(np.arange(5, len(clean) - 5, 8), 10, replace=False)
    angle = clean.angle.copy()
    angle[at] += random.choice([-1, 1], 10) * random.uniform(3, 6, 10)
    spiky = Trial(clean.t, clean.command, angle)
    signs = sensor_signs([spiky])
    assert signs.spikes
    assert signs.spike_rate * len(clean) == pytest.approx(10, abs=3)
    before, after = (np.sqrt(np.mean((t.angle - clean.angle) ** 2)) for t in (spiky, repaired(spiky, signs)))
    assert after < 0.6 * before


@pytest.mark.parametrize("kind", ["sine", "sines", "ramps"])
def test_held_samples_are_counted_and_repaired(kind: str) -> None:
    clean = trial(KINDS[kind][0], 0.05 * noise(KINDS[kind][0].size))
    angle = clean.angle.copy()
    starts = np.arange(20, len(clean) - 20, 60)
    for k in starts:
        angle[k : k + 6] = angle[k]
    held = Trial(clean.t, clean.command, angle)
    signs = sensor_signs([held])
    assert signs.drops
    assert signs.held_rate * len(clean) == pytest.approx(5 * starts.size, rel=0.25)
    before, after = (np.sqrt(np.mean((t.angle - clean.angle) ** 2)) for t in (held, repaired(held, signs)))
    assert after < 0.7 * before


@settings(max_examples=20)
@given(st.floats(0.03, 0.12), st.integers(8, 20), SEEDS)
def test_held_readings_that_do_not_jump_are_told_from_chance(sigma: float, length: int, seed: int) -> None:
    """At rest a held value resumes without a jump; a log of 0.01 deg repeats readings by chance as well."""
    rest = np.round(30.0 + sigma * noise(1000, seed), 2)
    own = trial(SINE[:1000])
    healthy, faulty = rest.copy(), rest.copy()
    for k in range(50, 950, 90):
        faulty[k : k + length] = faulty[k]
    assert not sensor_signs([Trial(own.t, own.command, healthy)]).drops
    signs = sensor_signs([Trial(own.t, own.command, faulty)])
    assert signs.drops
    assert signs.held_rate == pytest.approx(10 * (length - 1) / 1000, rel=0.1)


@settings(max_examples=20)
@given(st.floats(9.0, 25.0), st.floats(0.1, 0.5), SEEDS)
def test_steps_of_few_levels_are_recovered_through_dither(step: float, dither: float, seed: int) -> None:
    own = trial(SINE)
    y = np.round(np.round((own.angle + dither * step * noise(len(own), seed) / 2.5) / step) * step, 2)
    signs = sensor_signs([Trial(own.t, own.command, y)], 0.05)
    assert signs.quantisation_deg == pytest.approx(step, rel=1e-2)
    assert signs.coarse


def test_a_held_value_is_bridged_along_the_simulated_motion() -> None:
    """Where the motion turns while a value is held, a line misses it."""
    clean = trial(SINE, 0.05 * noise(SINE.size))
    turn = int(np.argmax(SINE[100:])) + 100
    angle = clean.angle.copy()
    for k in (turn - 4, turn - 90, turn - 150):
        angle[k : k + 12] = angle[k]
    held = Trial(clean.t, clean.command, angle)
    signs = sensor_signs([held])
    along = repaired(held, signs, 0.9 * trial(SINE).angle + 2.0)
    line = repaired(held, signs)
    errors = [np.sqrt(np.mean((t.angle - clean.angle)[turn - 3 : turn + 8] ** 2)) for t in (along, line)]
    assert errors[0] < max(0.5 * errors[1], 0.1)


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.3])
def test_a_clean_sensor_shows_no_sign(kind: str, sigma: float) -> None:
    own = trial(KINDS[kind][0], sigma * noise(KINDS[kind][0].size))
    signs = sensor_signs([own], sigma)
    assert not signs.spikes
    assert not signs.drops
    assert repaired(own, signs).angle.tolist() == own.angle.tolist()


@given(SEEDS)
@settings(max_examples=20)
def test_heavy_tails_are_a_fault_even_where_the_nominal_noise_is_unknown(seed: int) -> None:
    own, random = [trial(SINE)] * 4, np.random.default_rng(seed)
    heavy = [replace(one, angle=one.angle + 0.3 * random.standard_t(2.0, len(one))) for one in own]
    plain = [replace(one, angle=one.angle + 0.3 * random.standard_normal(len(one))) for one in own]
    assert sensor_signs(heavy).noisy
    assert not sensor_signs(plain).noisy

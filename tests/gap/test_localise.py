"""Laws of localisation: shares add up, densities average to one, and what was planted shows where it was planted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.residual import MOTION_PARTS, Localisation, explainable_share, localise, motion_part_labels
from hystmpc.trials.trial import Trial

from .contenders import low_pass
from .motions import DT, KINDS, LEVELS, THREE_SPEEDS, WIDTH, moves, multisine, sine, trial

TRIALS = [trial(c) for c in (sine(), moves(LEVELS, 1.0, 5.0), THREE_SPEEDS, KINDS["point_to_point"][0], multisine())]


def noise(own: Trial, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(len(own))


def at(residual: dict[str, float], sigma: float = 0.05) -> Localisation:
    """A constant error per place, and noise."""
    sizes = np.array([residual.get(place, 0.0) for place in MOTION_PARTS])
    errors = [sizes[motion_part_labels(own)] + sigma * noise(own, k) for k, own in enumerate(TRIALS)]
    return localise(TRIALS, errors, WIDTH)


@settings(max_examples=10)
@given(st.integers(0, 100))
def test_shares_add_up_and_densities_average_to_one(seed: int) -> None:
    random = np.random.default_rng(seed)
    errors = [random.normal(0, random.uniform(0.1, 2), len(own)) + random.normal() for own in TRIALS]
    found = localise(TRIALS, errors, WIDTH, seed)
    labels = np.concatenate([motion_part_labels(own) for own in TRIALS])
    time = np.bincount(labels, minlength=len(MOTION_PARTS)) / labels.size
    assert sum(place.share for place in found.places.values()) == pytest.approx(1)
    assert sum(found.places[name].density * time[k] for k, name in enumerate(MOTION_PARTS)) == pytest.approx(1)
    for place in found.places.values():
        assert 0 <= place.ci90[0] <= place.ci90[1] <= 1


@pytest.mark.parametrize("place", MOTION_PARTS)
def test_an_error_in_one_place_is_found_there(place: str) -> None:
    found = at({place: 1.0}).places
    assert max(found, key=lambda name: found[name].share) == place
    assert found[place].share > 0.9
    assert found[place].density > 1
    assert max(found[name].ci90[1] for name in MOTION_PARTS if name != place) < found[place].ci90[0]


def test_an_even_error_has_density_one_everywhere() -> None:
    found = at({}, sigma=1.0).places
    for place in found.values():
        assert place.density == pytest.approx(1, abs=0.2)


@pytest.mark.slow
def test_intervals_cover_the_share_nine_times_in_ten() -> None:
    inside = []
    for seed in range(60):
        errors = [(1 + (motion_part_labels(own) == 3)) * noise(own, 50 * seed + k) for k, own in enumerate(TRIALS)]
        labels = np.concatenate([motion_part_labels(own) for own in TRIALS])
        expected = 4 * np.mean(labels == 3) / (4 * np.mean(labels == 3) + np.mean(labels != 3))
        low, high = localise(TRIALS, errors, WIDTH, seed).places["hold"].ci90
        inside.append(low <= expected <= high)
    assert 0.8 <= np.mean(inside) <= 0.98


def test_labels_follow_their_precedence() -> None:
    own = trial(np.concatenate([np.linspace(0, 5, 51), np.full(50, 5.0), np.linspace(5, 0, 51), np.linspace(0, 3, 31)]))
    names = [MOTION_PARTS[k] for k in motion_part_labels(own)]
    assert names[10] == "first_flexure"
    assert names[80] == "hold"  # though the command has not turned yet
    assert names[104] == "after_reversal"
    assert names[130] == "unloading"
    assert names[154] == "after_reversal"
    assert names[-1] == "loading"


@given(st.floats(0.1, 100), st.floats(-50, 50))
@settings(max_examples=10)
def test_parts_of_a_motion_do_not_depend_on_the_unit_of_the_command(scale: float, offset: float) -> None:
    for own in TRIALS[:3]:
        other = Trial(own.t, scale * own.command + offset, own.angle)
        assert np.mean(motion_part_labels(other) != motion_part_labels(own)) < 0.01  # rounding at the edges


@pytest.mark.parametrize("hz", [0.3, 1.13, 3.4])
def test_a_line_that_is_not_the_commands_is_found(hz: float) -> None:
    errors = [0.5 * np.sin(2 * np.pi * hz * own.t + k) + 0.2 * noise(own, k) for k, own in enumerate(TRIALS)]
    (line,) = localise(TRIALS, errors, WIDTH).spectrum.lines
    assert line.hz == pytest.approx(hz, abs=0.03)
    assert line.share == pytest.approx(0.125 / 0.165, abs=0.1)


@pytest.mark.parametrize("kind", ["noise", "static", "lag"])
def test_no_line_is_invented(kind: str) -> None:
    for seed in range(5):
        errors = {
            "noise": [noise(own, seed + 100 * k) for k, own in enumerate(TRIALS)],
            "static": [0.3 * (own.command - 2) ** 2 + 0.1 * noise(own, seed) for own in TRIALS],
            "lag": [low_pass(own.angle, 0.2, DT) - own.angle + 0.1 * noise(own, seed) for own in TRIALS],
        }[kind]
        assert localise(TRIALS, errors, WIDTH).spectrum.lines == ()


def test_coherence_follows_the_command() -> None:
    linear = localise(TRIALS, [0.3 * own.command + 0.02 * noise(own) for own in TRIALS], WIDTH).spectrum
    white = localise(TRIALS, [noise(own, k) for k, own in enumerate(TRIALS)], WIDTH).spectrum
    assert linear.coherent > 0.9
    assert white.coherent < 0.2


def test_memory_names_what_the_error_remembers() -> None:
    late = [low_pass(own.command, 3.0, DT) - own.command for own in TRIALS]
    clock = np.cumsum([0.0, *(own.duration_s for own in TRIALS)])
    planted = {
        "speed": [np.tanh(np.gradient(own.command, DT)) for own in TRIALS],
        "clock": [(start + own.t) / 60 for start, own in zip(clock[:-1], TRIALS, strict=True)],
    }
    for name, errors in planted.items():
        found = localise(TRIALS, [e + 0.05 * noise(o) for e, o in zip(errors, TRIALS, strict=True)], WIDTH).memory
        assert max(found, key=lambda key: found[key]) == name
        assert found[name] > 0.7
    assert localise(TRIALS, late, WIDTH).memory["hold_age"] > 0.1
    plain = localise(TRIALS, [noise(own, k) for k, own in enumerate(TRIALS)], WIDTH).memory
    assert max(plain.values()) < 0.02


def test_the_ceiling_is_what_the_command_explains() -> None:
    shaped = [0.5 * (low_pass(own.command, 4.0, DT) - own.command) for own in TRIALS]
    power = np.concatenate(shaped) @ np.concatenate(shaped) / sum(map(len, shaped))
    noisy = [e + power**0.5 * noise(own, k) for k, (e, own) in enumerate(zip(shaped, TRIALS, strict=True))]
    assert explainable_share(TRIALS, shaped) > 0.95
    assert explainable_share(TRIALS, noisy) == pytest.approx(0.5, abs=0.06)
    assert explainable_share(TRIALS, [noise(own, k) for k, own in enumerate(TRIALS)]) < 0.02
    assert explainable_share(TRIALS, noisy, seed=3) == explainable_share(TRIALS, noisy, seed=3)


def test_one_trial_is_enough_and_a_seed_settles_everything() -> None:
    errors = [noise(TRIALS[1]) + 0.1 * TRIALS[1].command]
    assert localise(TRIALS[1:2], errors, WIDTH, 4) == localise(TRIALS[1:2], errors, WIDTH, 4)
    assert 0 <= explainable_share(TRIALS[1:2], errors) <= 1

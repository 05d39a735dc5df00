"""A set of the first flexure is said where two rests at one command show one, and never of a device without."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.trials.check import check
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from .random_logs import Device, answer, device

DT = 0.04
few = settings(max_examples=30, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def resting(random: np.random.Generator, start: float, turns: int, rest_s: float, back: bool = True) -> Vec:
    """Flexures from a rest at `start` to random commands above 3 and back to it, with a rest there, or elsewhere."""
    parts, at = [np.full(round(rest_s / DT), start)], start

    def to(value: float, seconds: float) -> None:
        nonlocal at
        count = round(seconds / DT)
        parts.append(at + (value - at) * (0.5 - 0.5 * np.cos(np.pi * np.arange(1, count + 1) / count)))
        at = value

    for _ in range(turns):
        to(float(random.uniform(3.5, 6.0)), float(random.uniform(0.5, 6.0)))
        parts.append(np.full(round(float(random.choice([0.0, 1.5])) / DT), at))
        if random.random() < 0.3:
            to(0.0, float(random.uniform(0.5, 6.0)))
        to(start if back else float(random.uniform(0.0, 3.0)), float(random.uniform(0.5, 6.0)))
        parts.append(np.full(round(rest_s * random.uniform(0.5, 2.0) / DT), at))
    return np.concatenate(parts)


def recorded(command: Vec, made: Device, random: np.random.Generator, play_at: float = 0.0) -> Trial:
    """The device's answer to a command."""
    angle = answer(command, DT, made, random, play_at)
    return Trial(DT * np.arange(command.size), command, angle, units=Units("mm", "deg"))


@few
@given(seeds, st.booleans())
def test_of_a_device_without_one_no_set_is_said(seed: int, from_the_end: bool) -> None:
    random = np.random.default_rng(seed)
    start = 0.0 if from_the_end else float(random.uniform(0.5, 2.5))
    command = resting(random, start, int(random.integers(1, 4)), float(random.uniform(0.8, 8.0)))
    made = device(random, creeps=True)
    made = replace(
        made, play=float(random.choice([0.0, 0.3, 1.0, 3.0, 6.0])), lag_s=float(random.choice([0.0, 0.3, 2, 8]))
    )
    # From the end of its range a device was only ever approached from within.
    play_at = float(random.uniform(0.0 if from_the_end else -1.0, 1.0))
    trial = recorded(command, made, random, play_at)
    (finding,) = check(trial).of("first flexure")
    assert "a set of" not in finding.message
    assert len(finding.message) <= 300


@few
@given(seeds, st.sampled_from([-0.5, -0.3, -0.15, 0.15, 0.3, 0.5]))
def test_a_set_is_said_with_its_sign_and_size(seed: int, share: float) -> None:
    random = np.random.default_rng(seed)
    command = resting(random, 0.0, int(random.integers(1, 4)), 4.0)
    made = Device(
        delay_s=float(random.uniform(0, 0.2)), lag_s=float(random.uniform(0, 0.1)), set=share, noise=0.05,
        gain=float(random.uniform(5, 15) * random.choice([-1, 1])),
    )  # fmt: skip
    trial = recorded(command, made, random)
    (finding,) = check(trial).of("first flexure")
    said = re.search(r"(?:a set of )?([+-][\d.]+) deg(?:, by a set|;)", finding.message)
    assert said, finding.message
    first = command[: np.flatnonzero(np.diff(command) < 0)[0] + 1].max()
    # It may have to rest a second time to be sure, after a greater bend.
    after = made.gain * share * np.array([first, command.max()])
    assert min(abs(float(said[1]) - after)) <= 0.06 * abs(after[1]) + 0.2
    assert np.sign(float(said[1])) == np.sign(after[0])


@few
@given(seeds)
def test_an_angle_is_quoted_only_at_a_command_at_which_it_was_recorded(seed: int) -> None:
    random = np.random.default_rng(seed)
    start = float(random.uniform(0.0, 2.5))
    command = resting(random, start, 2, 3.0, back=bool(random.random() < 0.7))
    trial = recorded(command, replace(device(random), set=float(random.choice([0.0, 0.4]))), random)
    (finding,) = check(trial).of("first flexure")
    quoted = re.search(r"at rest at (\S+) mm the angle was (\S+) deg before it and is (\S+) deg after", finding.message)
    if quoted is None:
        assert "deg" not in finding.message
        return
    here = trial.angle[np.abs(command - float(quoted[1])) <= 0.006 * np.ptp(command)]
    for angle in quoted.groups()[1:]:
        assert np.min(np.abs(here - float(angle))) <= 5e-4 * max(abs(float(angle)), 1e-3)


def test_two_rests_tell_of_a_play_that_it_may_be_one() -> None:
    random = np.random.default_rng(3)
    command = resting(random, 0.0, 1, 4.0)
    (finding,) = check(recorded(command, Device(play=2.0), random)).of("first flexure")
    assert "by a set or by a play that began elsewhere" in finding.message


@pytest.mark.parametrize("start", [0.0, 2.0])
def test_a_device_that_comes_back_is_said_to(start: float) -> None:
    random = np.random.default_rng(4)
    (finding,) = check(recorded(resting(random, start, 2, 4.0), Device(), random)).of("first flexure")
    assert "it comes back" in finding.message

"""Noise of a recorded command: a command without it stays as it is, and what is left of it moves no play."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hystmpc
from hystmpc.trials.command_noise import remove_command_noise
from hystmpc.trials.read import at_rate
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

_SENT = ("holds", "steps", "ramps", "sine", "multisine", "chirp", "random levels")


def _command(kind: str, t: Vec, random: np.random.Generator) -> Vec:
    """A command of range 1 or so, as controllers send it."""
    last, levels = float(t[-1]), random.uniform(0, 1, int(random.integers(6, 16)))
    if kind == "holds":
        return np.interp(t, np.linspace(0, last, 2 * levels.size), np.repeat(levels, 2))
    if kind == "steps":
        return np.asarray(levels[np.minimum((t / last * levels.size).astype(int), levels.size - 1)])
    if kind == "ramps":
        return np.interp(t, np.linspace(0, last, levels.size), levels)
    if kind == "sine":
        return 0.5 - 0.5 * np.cos(2 * np.pi * random.uniform(0.05, 2.0) * t)
    if kind == "multisine":
        return sum(0.1 * np.sin(2 * np.pi * f * t + 20 * f) for f in random.uniform(0.05, 3.0, 8)) + 0.5
    if kind == "chirp":
        return 0.5 - 0.5 * np.cos(2 * np.pi * (0.1 + 2.0 * t / last) * t)
    return np.repeat(random.uniform(0, 1, t.size), random.integers(1, 10))[: t.size]


def _angle(command: Vec, dt: float, random: np.random.Generator) -> Vec:
    """A device with a lag and a play, and a sensor with noise."""
    tau, width, gain = random.uniform(0.02, 0.5), random.uniform(0, 0.1) * np.ptp(command), 10 ** random.uniform(-1, 2)
    lagged = play = float(command[0])
    angle = np.empty_like(command)
    for k, u in enumerate(command):
        lagged += (u - lagged) * (1 - np.exp(-dt / tau))
        play = max(lagged - width, min(lagged + width, play))
        angle[k] = gain * (0.5 * lagged + 0.5 * play)
    return angle + 10 ** random.uniform(-5, -2.5) * np.ptp(angle) * random.standard_normal(angle.size)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), kind=st.sampled_from(_SENT), rate=st.sampled_from([10.0, 25.0, 100.0, 250.0]))
def test_a_command_that_was_sent_is_left_as_it_is(seed: int, kind: str, rate: float) -> None:
    random = np.random.default_rng(seed)
    t: Vec = np.arange(int(random.integers(300, 2500)), dtype=np.float64) / rate
    command = 10 ** random.uniform(-2, 2) * np.round(_command(kind, t, random), int(random.integers(2, 7)))
    trial = Trial(t, command, _angle(command, 1 / rate, random))
    assert remove_command_noise([trial])[0] is trial
    assert at_rate([trial], rate)[0] is trial


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), level=st.floats(1e-3, 0.03), held=st.sampled_from([1, 4]))
def test_noise_of_a_measured_command_is_found_and_leaves_no_travel(seed: int, level: float, held: int) -> None:
    """Of white noise, and of a sensor that is slower than the log."""
    random, dt = np.random.default_rng(seed), 0.04 / held
    t: Vec = np.arange(1500 * held, dtype=np.float64) * dt
    commands = [5 * _command(kind, t, random) for kind in ("holds", "steps", "holds", "ramps")]
    sigma = 5 * level
    measured = [u + sigma * np.repeat(random.standard_normal(1500), held) for u in commands]
    trials = [Trial(t, m, _angle(u, dt, random)) for u, m in zip(commands, measured, strict=True)]
    found = remove_command_noise(trials)
    assert remove_command_noise(found) == found
    for trial, before, command in zip(found, trials, commands, strict=True):
        assert 0.6 * sigma < trial.command_noise < 1.6 * sigma
        assert np.array_equal(trial.angle, before.angle)
        assert np.sqrt(np.mean((trial.command - command) ** 2)) < 0.8 * sigma
        assert _travel(trial.command) - _travel(command) < 0.2 * (_travel(before.command) - _travel(command))


def _travel(command: Vec) -> float:
    return float(np.abs(np.diff(command)).sum())


def test_a_command_whose_quick_part_moves_the_device_is_left_as_it_is() -> None:
    random = np.random.default_rng(3)
    t: Vec = np.arange(2000, dtype=np.float64) * 0.04
    real = 3 * _command("holds", t, random) + 0.05 * random.standard_normal(t.size)
    trial = Trial(t, real, 12 * real + 0.02 * random.standard_normal(t.size))
    assert remove_command_noise([trial])[0] is trial
    other = Trial(t, real, 12 * _command("holds", t, np.random.default_rng(3)))
    assert remove_command_noise([other])[0].command_noise > 0.0


@pytest.mark.parametrize("kind", ["backlash", "pi"])
@pytest.mark.parametrize("level", [0.002, 0.02])
def test_a_model_of_a_noisy_command_is_right_on_the_clean_one(kind: str, level: float) -> None:
    random = np.random.default_rng(7)
    t: Vec = np.arange(1000, dtype=np.float64) * 0.04
    clean: list[Trial] = []
    noisy: list[Trial] = []
    for k in range(3):
        command = 5 * _command("holds" if k else "ramps", t, random)
        play, angle = float(command[0]), np.empty_like(command)
        for j, u in enumerate(command):
            play = max(u - 0.3, min(u + 0.3, play))
            angle[j] = 12 * play
        angle += 0.02 * random.standard_normal(angle.size)
        measured = command + 5 * level * random.standard_normal(t.size)
        clean.append(Trial(t, command, angle, source=f"clean {k}"))
        noisy.append(Trial(t, measured, angle, source=f"noisy {k}"))
    errors = {}
    for name, trials in (("clean", clean), ("noisy", noisy)):
        model = hystmpc.fit(kind, trials, rate_hz=25.0)
        errors[name] = np.sqrt(np.mean([run.errors.rmse_deg**2 for run in hystmpc.evaluate(model, clean)]))
    assert errors["noisy"] < errors["clean"] + 0.7 * 12 * 5 * level  # of a standard deviation of the noise

"""Frequencies of the motion itself: no disturbance is looked for there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.identify.motion_lines import fundamental_hz, motion_frequencies, strongest_line
from hystmpc.models.identify.runs import Run
from hystmpc.trials.types import Vec

from ..gap.engine_examples import device_runs

DT = 0.04


def triangle(hz: float, seconds: float) -> Vec:
    """Commands from 0 to 6 at constant speed."""
    return 6.0 - 12.0 * np.abs((hz * DT * np.arange(round(seconds / DT))) % 1 - 0.5)


def runs_of(commands: list[Vec]) -> list[Run]:
    """Runs of these commands."""
    base = device_runs()[0]
    return [
        replace(base, command=u, angle=u, counts=np.ones(u.size, dtype=np.bool_), correction=np.zeros(u.size))
        for u in commands
    ]


@given(st.floats(0.1, 0.5), st.integers(4, 10), st.integers(2, 4), st.integers(0, 99))
def test_no_line_is_found_nearer_than_the_trials_resolve(hz: float, periods: int, count: int, seed: int) -> None:
    """The errors are those of a width that differs from trial to trial: lines of the motion, of any height."""
    random, runs = np.random.default_rng(seed), runs_of([triangle(hz, periods / hz)] * count)
    errors = [
        random.normal() * np.roll(r.command - 3, int(random.integers(40))) + 0.1 * random.normal(size=r.command.size)
        for r in runs
    ]
    found = strongest_line(runs, errors, 0.15, 5.0)
    resolved = 1 / sum(run.command.size * run.dt_s for run in runs)
    assert found == 0.0 or abs(found - max(round(found / hz), 1) * hz) >= 0.99 * resolved


def test_a_disturbance_beside_the_motion_is_still_found() -> None:
    runs, t = runs_of([triangle(0.157, 40.0)] * 3), DT * np.arange(1000)
    errors = [np.sin(2 * np.pi * 1.13 * t + k) for k in range(3)]
    assert strongest_line(runs, errors, 0.15, 5.0) == pytest.approx(1.13, abs=1e-3)


@given(st.floats(0.12, 0.5), st.integers(1, 3), st.floats(-0.9, 0.9), st.floats(0, 3))
def test_a_wave_that_hides_under_the_motion_is_not_found_on_its_flanks(
    hz: float, harmonic: int, away: float, phase: float
) -> None:
    """It lies within 1/T of a harmonic; what it leaks to frequencies beside is no line."""
    runs = runs_of([triangle(hz, 40.0), triangle(hz, 48.0)])
    wave = harmonic * hz + away / 88.0
    errors = [np.sin(2 * np.pi * wave * DT * np.arange(r.command.size) + phase) for r in runs]
    found = strongest_line(runs, errors, 0.15, 5.0)
    assert found == 0.0 or abs(found - wave) > 4.0 / 40.0


def test_a_motion_of_few_trials_hides_nothing() -> None:
    moves = [np.interp(DT * np.arange(1000), [0, 3, 9, 11, 30, 40], [0, 6, 1, 5, 2, 2]) for _ in range(3)]
    assert fundamental_hz(triangle(0.2, 40.0), DT) == pytest.approx(0.2, abs=1e-3)
    hz = np.array([1.0])
    assert not motion_frequencies(runs_of([triangle(0.2, 40.0), *moves]), hz)[0]
    assert motion_frequencies(runs_of([triangle(0.2, 40.0)] * 2), hz)[0]

"""Logs beyond what can be diagnosed are thinned to trials that keep what matters; what is held at once stays small."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.logs import trial_choice
from hystmpc.gap.logs.check import CheckedTrials, check_trials
from hystmpc.gap.logs.motion_type import MotionType, command_segments, motion_type
from hystmpc.gap.logs.noise_floor import find_repeats
from hystmpc.gap.logs.trial_choice import MOST_SAMPLES, Workload, affordable
from hystmpc.gap.residual import explainable_share
from hystmpc.models.identify.problem import strongest_line
from hystmpc.models.identify.runs import Before, Run, runs_of
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..models.zoo import BACKLASH
from .engine_examples import simulator_of
from .motions import DT, KINDS, sine, trial

MB = 1e6


def of_kinds(kinds: list[str]) -> list[Trial]:
    """Trials of these kinds of motion, each of a length and a size of its own."""
    made = []
    for k, kind in enumerate(kinds):
        command = (0.6 + 0.4 * np.sin(k)) * KINDS[kind][0]
        made.append(trial(command[: command.size - 7 * (k % 5)], name=f"{k}.csv"))
    return made


def chosen(trials: list[Trial], most: int, seed: int = 0) -> Workload:
    return affordable(trials, [motion_type(t, command_segments(t)) for t in trials], seed, most)


MANY = st.lists(st.sampled_from(sorted(KINDS)), min_size=1, max_size=30)


@settings(max_examples=20)
@given(kinds=MANY, most=st.integers(300, 20_000), seed=st.integers(0, 100))
def test_never_more_than_can_be_afforded_and_never_without_the_first_the_last_or_a_kind(
    kinds: list[str], most: int, seed: int
) -> None:
    trials = of_kinds(kinds)
    found = chosen(trials, most, seed)
    sizes = [len(trials[k]) for k in found.kept]
    assert sum(found.samples) <= max(most, 0)
    assert all(0 < used <= size for used, size in zip(found.samples, sizes, strict=True))
    assert list(found.kept) == sorted(set(found.kept))
    assert {0, len(trials) - 1} <= set(found.kept)
    motions = [motion_type(t, command_segments(t)) for t in trials]
    assert {motions[k] for k in found.kept} == set(motions)
    assert found == chosen(trials, most, seed)
    whole = sum(len(t) for t in trials) <= most
    assert bool(found.note) is not whole
    if whole:
        assert found.kept == tuple(range(len(trials)))
        assert list(found.samples) == sizes


@settings(max_examples=10)
@given(first=st.integers(1, 18), later=st.integers(1, 17), seed=st.integers(0, 100))
def test_a_repeat_is_kept_with_what_it_repeats(first: int, later: int, seed: int) -> None:
    """Twenty sines of different speeds, of which one comes twice."""
    second = 1 + (first - 1 + later) % 18
    trials = [trial(sine(0.1 + 0.02 * k), name=f"{k}.csv") for k in range(20)]
    trials[second] = replace(trials[first], source="again.csv")
    found = chosen(trials, 10_000, seed)
    assert {first, second} <= set(found.kept)


@pytest.mark.slow
def test_long_trials_are_cut_before_fewer_than_twelve_are_used() -> None:
    trials = [trial(np.tile(sine(0.2), 20), name=f"{k}.csv") for k in range(40)]
    found = chosen(trials, 60_000)
    assert len(found.kept) == 12
    assert max(found.samples) == 5_000
    assert "40 trials, 600,800 samples at 25 Hz, more than are diagnosed in minutes" in found.note
    assert "of 12 long ones the first 200 s" in found.note
    assert "\n" not in found.note


def test_what_today_is_usual_is_not_thinned() -> None:
    trials = [trial(np.tile(sine(0.2), 2), name=f"{k}.csv") for k in range(10)]
    found = chosen(trials, MOST_SAMPLES)
    assert found.kept == tuple(range(10))
    assert found.note == found.estimate == ""


def thinned(trials: list[Trial], most: int, patch: pytest.MonkeyPatch) -> CheckedTrials:
    """Trials checked where fewer samples can be afforded."""

    def few(trials: list[Trial], motions: list[MotionType], seed: int, ordered: bool) -> Workload:
        return affordable(trials, motions, seed, most, ordered)

    patch.setattr(trial_choice, "affordable", few)
    return check_trials(trials, simulator_of(BACKLASH))


@pytest.mark.slow
def test_trials_left_out_still_count_as_time_and_as_bending(monkeypatch: pytest.MonkeyPatch) -> None:
    trials = [trial((0.5 + 0.025 * k) * sine(0.1 + 0.02 * k), name=f"{k}.csv") for k in range(20)]
    every, some = check_trials(trials, simulator_of(BACKLASH)), thinned(trials, 10_000, monkeypatch)
    assert len(some.trials) < len(trials)
    assert some.notes[0] == some.left_out[0]
    all_runs = {run.name: run for run in runs_of(every.trials, None, every.before)}
    for run in runs_of(some.trials, None, some.before):
        assert run.clock_s == all_runs[run.name].clock_s
        assert run.bent_before == all_runs[run.name].bent_before
    assert Before.each(every.trials) == every.before


def test_a_cut_trial_is_cut_alike_in_every_form(monkeypatch: pytest.MonkeyPatch) -> None:
    trials = [trial(np.tile(sine(0.2), 4), name=f"{k}.csv") for k in range(4)]
    checked = thinned(trials, 4_000, monkeypatch)
    for own, given_ in zip(checked.trials, checked.given, strict=True):
        assert len(own) == 1_000
        assert own.t[-1] == pytest.approx(given_.t[-1], abs=DT)


def peak_mb(work: Callable[[], Any]) -> float:
    """Memory that is held at most while it works [MB]."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / MB
    finally:
        tracemalloc.stop()


def long_runs(seconds: float, count: int) -> tuple[tuple[Run, ...], list[Trial], list[Vec]]:
    """Runs and errors with a line of 1.281 Hz."""
    random = np.random.default_rng(0)
    t = np.arange(round(seconds / DT)) * DT
    command = 2.5 * (1 - np.cos(0.7 * t)) + 0.3 * np.sin(2.1 * t)
    trials = [trial(command, name=f"{k}.csv") for k in range(count)]
    errors = [np.sin(2 * np.pi * 1.281 * t + k) + random.normal(0, 1, t.size) for k in range(count)]
    return tuple(replace(run, counts=np.ones_like(run.counts)) for run in runs_of(trials)), trials, errors


def test_the_search_for_a_line_holds_no_table_of_waves() -> None:
    """Ten minutes are 15,000 samples and 11,640 frequencies: 2.8 GB for the table of all waves."""
    runs, _, errors = long_runs(600.0, 1)
    lines: list[float] = []
    assert peak_mb(lambda: lines.append(strongest_line(list(runs), errors, 0.15, 5.0))) < 20
    assert lines[0] == pytest.approx(1.281, abs=1e-4)


def test_a_line_is_where_the_table_of_all_waves_has_it() -> None:
    runs, _, errors = long_runs(30.0, 3)
    part = [replace(run, counts=np.arange(run.command.size) >= 100) for run in runs]
    kept = [error[100:] for error in errors]
    grid = np.arange(0.15, 5.0, 0.25 / max(error.size * DT for error in kept))
    waves = np.exp(-2j * np.pi * np.outer(grid, DT * np.arange(kept[0].size)))
    power = sum(np.abs(waves @ (error - error.mean())) ** 2 / error.size for error in kept)
    found = strongest_line(part, kept, 0.15, 5.0)
    assert abs(found - grid[int(np.argmax(power))]) <= 0.5 * (grid[1] - grid[0])


@pytest.mark.slow
def test_the_ceiling_holds_the_features_of_one_trial_at_a_time() -> None:
    """Of six trials of 100 s 184 features are 22 MB, in several copies before."""
    _, trials, errors = long_runs(100.0, 6)
    assert peak_mb(lambda: explainable_share(trials, errors)) < 25


def test_repeats_of_long_trials_are_what_they_were() -> None:
    """Shifts are voted for by marks within two samples of them, whatever the number of marks."""
    repeated = np.tile(KINDS["holds"][0], 3)
    found = find_repeats([trial(repeated)])
    period = KINDS["holds"][0].size
    assert {round(repeat.shift) for repeat in found} == {period, 2 * period}

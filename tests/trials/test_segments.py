"""Laws of segmentation: a partition, blind to scale, offset and noise; ramps do not turn, holds hold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.errors import LogError
from hystmpc.trials.segments import Motion, SegmentRule, Segments, first_flexure_end, segment
from hystmpc.trials.trial import Trial, resample

RATE_HZ = 20.0
# Whole numbers below 50 keep every threshold away from every difference, so that equality is exact.
COMMANDS = st.lists(st.integers(-40, 40), min_size=3, max_size=80).map(lambda c: np.repeat(c, 3).astype(float))
MOVES = st.lists(st.tuples(st.integers(-5, 5).filter(bool), st.integers(0, 40)), min_size=1, max_size=8)


def trial_of(command: np.ndarray) -> Trial:
    return Trial(np.arange(command.size) / RATE_HZ, command, np.zeros(command.size), source="log.csv")


def ramps(moves: list[tuple[int, int]]) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Ramps of 20 samples, each followed by a hold; and the holds that are long enough to count."""
    command, holds = [0.0], []
    for height, length in moves:
        command += (command[-1] + height * np.arange(1, 21)).tolist()
        if length / RATE_HZ >= SegmentRule().hold_s:
            holds.append((len(command) - 1, len(command) + length))
        command += [command[-1]] * length
    return np.array(command), holds


@given(COMMANDS)
def test_labels_and_runs_partition_the_trial(command: np.ndarray) -> None:
    parts = segment(trial_of(command))
    runs = sorted(run for motion in Motion for run in parts.runs(motion))
    assert [k for start, stop in runs for k in range(start, stop)] == list(range(command.size))
    assert np.all(np.diff(parts.reversals) > 0)


@given(COMMANDS, st.integers(1, 9), st.integers(-100, 100))
def test_scale_and_offset_do_not_matter(command: np.ndarray, scale: int, offset: int) -> None:
    plain, moved = segment(trial_of(command)), segment(trial_of(scale * command + offset))
    np.testing.assert_array_equal(plain.labels, moved.labels)
    np.testing.assert_array_equal(plain.reversals, moved.reversals)


@given(COMMANDS)
def test_a_mirrored_command_swaps_loading_and_unloading(command: np.ndarray) -> None:
    plain, mirrored = segment(trial_of(command)), segment(trial_of(-command))
    np.testing.assert_array_equal(plain.labels, -mirrored.labels)
    np.testing.assert_array_equal(plain.reversals, mirrored.reversals)


@given(COMMANDS)
def test_the_command_rises_while_loading_and_falls_while_unloading(command: np.ndarray) -> None:
    assume(np.ptp(command) > 0)
    parts = segment(trial_of(command))
    step = np.diff(command, prepend=command[0])
    assert np.all(step[parts.labels == Motion.LOADING] >= 0)
    assert np.all(step[parts.labels == Motion.UNLOADING] <= 0)


@given(st.lists(st.floats(0.01, 1.0), min_size=2, max_size=60), st.sampled_from([1, -1]))
def test_a_monotone_ramp_never_turns(steps: list[float], sign: int) -> None:
    trial = trial_of(sign * np.cumsum(steps))
    parts = segment(trial, SegmentRule(hold_s=1e3))
    assert parts.reversals.size == 0
    assert set(parts.labels.tolist()) == {sign}
    with pytest.raises(LogError, match=r"log\.csv: the command never turns back"):
        first_flexure_end(trial)


@given(MOVES)
def test_a_hold_is_a_hold_and_a_ramp_is_none(moves: list[tuple[int, int]]) -> None:
    command, holds = ramps(moves)
    assert segment(trial_of(command)).holds == holds


@given(MOVES, st.integers(0, 1000))
def test_noise_below_the_threshold_adds_no_reversal(moves: list[tuple[int, int]], seed: int) -> None:
    command, _ = ramps(moves)
    amplitude = 0.002 * np.ptp(command)
    noise = amplitude * np.random.default_rng(seed).uniform(-1, 1, command.size)
    plain, noisy = segment(trial_of(command)), segment(trial_of(command + noise))
    assert noisy.reversals.size == plain.reversals.size
    assert np.all(np.abs(command[noisy.reversals] - command[plain.reversals]) <= 2 * amplitude)


def test_a_constant_command_is_one_hold() -> None:
    parts = segment(trial_of(np.full(5, 2.5)))
    assert parts.holds == [(0, 5)]
    assert parts.reversals.size == 0


def test_the_crest_of_a_slow_sine_is_no_hold() -> None:
    t = np.arange(0, 70, 1 / RATE_HZ)
    command = np.exp(-0.0278 * t) * (1 - np.cos(2 * np.pi * 0.1 * t))  # seven cycles of 0.1 Hz, decaying to 1/7
    parts = segment(trial_of(command))
    assert parts.reversals.size == 13
    assert parts.holds == []


def test_the_first_flexure_ends_where_the_command_starts_back() -> None:
    command = np.array([0, 1, 2, 3, 3, 3, 2, 1, 0, 1, 2], dtype=float)
    assert first_flexure_end(trial_of(command)) == 5


def test_uneven_sampling_is_refused() -> None:
    trial = Trial([0, 0.1, 0.3, 0.4], [0, 1, 0, 1], [0, 0, 0, 0])
    for function in (segment, first_flexure_end):
        with pytest.raises(LogError, match="resample"):
            function(trial)


def test_real_sinusoids_of_seven_cycles_turn_thirteen_times(real_logs) -> None:
    for path in real_logs:
        trial = resample(read_csv(path), 50)
        parts: Segments = segment(trial)
        assert parts.reversals.size == 13, path
        assert first_flexure_end(trial) == parts.reversals[0]
        assert trial.angle[parts.reversals[0]] > 85


def test_holds_that_meet_are_two() -> None:
    """A move within one sample: without a sample of its own it would join the holds into one that does not hold."""
    command = np.concatenate([np.linspace(0.0, 5.0, 50), np.full(40, 5.0), np.full(40, 5.2), np.linspace(5.2, 0.0, 50)])
    holds = segment(trial_of(command)).holds
    assert len(holds) == 2
    for start, stop in holds:
        assert np.ptp(command[start:stop]) == 0

"""The Trial type: what it refuses, and that it travels between processes."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import hystmpc
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import LogError
from hystmpc.trials.trial import Trial, Units, parts_at_gaps, resample


def make(**changes: object) -> Trial:
    values = {"t": [0, 1, 2], "command": [0, 1, 0], "angle": [30, 31, 30], "source": "log.csv"} | changes
    return Trial(**values)


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"t": [0, 1, 1]}, ["sample 2", "increasing"]),
        ({"angle": [30, np.nan, 30]}, ["angle is nan", "sample 1"]),
        ({"command": [0, 1]}, ["command has 2", "expected 3"]),
        ({"channels": {"current": [1.0]}}, ["current has 1", "expected 3"]),
        ({"channels": {"pose": np.zeros((3, 1))}}, ["pose has shape (3, 1)"]),
        ({"t": [0], "command": [0], "angle": [0]}, ["1 samples", "at least 2"]),
        ({"t": np.zeros((3, 2))}, ["t has shape (3, 2), expected one dimension (T,)"]),
        ({"command": np.zeros((3, 10))}, ["command has shape (3, 10)", "at most 9 axes"]),
        ({"angle": [[30, 1], [31, np.inf], [30, 1]]}, ["angle is inf", "sample 1"]),
        ({"inputs": {"pressure_bar": [1, np.nan, 1]}}, ["pressure_bar is nan", "sample 1"]),
        ({"inputs": {"pressure_bar": [1, 1]}}, ["pressure_bar has 2", "expected 3"]),
        ({"inputs": {key: [1, 1, 1] for key in "abcdefg"}}, ["7 inputs", "at most 6"]),
    ],
)
def test_faults_are_named_with_source_and_place(changes: dict[str, object], parts: list[str]) -> None:
    with pytest.raises(LogError) as caught:
        make(**changes)
    assert all(part in str(caught.value) for part in ["log.csv", *parts])


@pytest.mark.parametrize("travel", [copy.deepcopy, lambda trial: pickle.loads(pickle.dumps(trial))])
def test_a_trial_can_be_copied_and_pickled(travel) -> None:
    trial = make(channels={"current": [1, 2, 3]}, units=Units("bar"))
    other = travel(trial)
    np.testing.assert_array_equal(other.channels["current"], trial.channels["current"])
    np.testing.assert_array_equal(other.angle, trial.angle)
    assert (other.units, other.source) == (trial.units, trial.source)


def test_a_trial_cannot_be_changed() -> None:
    source = np.array([0.0, 1.0, 2.0])
    trial = make(t=source, channels={"current": source})
    source[:] = 7
    assert trial.t.tolist() == trial.channels["current"].tolist() == [0, 1, 2]
    for signal in (trial.t, trial.command, trial.angle, trial.channels["current"]):
        with pytest.raises(ValueError, match="read-only"):
            signal[0] = 1
    with pytest.raises(TypeError):
        trial.channels["new"] = source


def test_a_part_keeps_its_time_and_channels() -> None:
    part = make(channels={"current": [1, 2, 3]}).select(1)
    assert (part.t.tolist(), part.channels["current"].tolist(), part.duration_s, len(part)) == ([1, 2], [2, 3], 1, 2)


def test_a_trial_prints_as_one_line() -> None:
    trial = Trial(np.arange(3.0), np.zeros(3), np.ones(3), units=Units("mm", "deg"), source="log.csv")
    assert repr(trial) == "Trial(log.csv: 3 samples in 2 s, mm to deg)"


def two_axes(samples: int = 600) -> Trial:
    """Two commands, two angles and a pressure, with a gap."""
    t = 0.02 * np.arange(samples) + np.where(np.arange(samples) < samples // 2, 0.0, 5.0)
    u = np.column_stack([np.sin(t), np.cos(t)])
    return Trial(t, u, 20 * u + 1, {"current": t}, source="log.csv", inputs={"pressure_bar": 1 + 0.1 * t})


def test_a_trial_of_several_axes_is_cut_resampled_and_copied_as_one_of_one_axis() -> None:
    """Axis by axis the same numbers to the last bit, inputs too."""
    both = two_axes()
    singles = [Trial(both.t, both.commands[:, i], both.angles[:, i], inputs=both.inputs) for i in range(2)]
    ways = [
        lambda trial: trial.select(20, 80),
        lambda trial: parts_at_gaps(trial)[1],
        lambda trial: resample(trial.select(0, 300), 30.0),
        copy.deepcopy,
        lambda trial: pickle.loads(pickle.dumps(trial)),
    ]
    for way in ways:
        got = way(both)
        assert got.commands.shape == got.angles.shape == (len(got), 2)
        for i, alone in enumerate(map(way, singles)):
            np.testing.assert_array_equal(got.commands[:, i], alone.command)
            np.testing.assert_array_equal(got.angles[:, i], alone.angle)
            np.testing.assert_array_equal(got.inputs["pressure_bar"], alone.inputs["pressure_bar"])


def test_one_axis_is_one_axis_however_it_is_given() -> None:
    trial = make(command=[[0], [1], [0]], inputs={"pressure_bar": [1, 2, 3]})
    assert (trial.command.tolist(), trial.commands.shape, trial.angles.shape) == ([0, 1, 0], (3, 1), (3, 1))
    with pytest.raises(ValueError, match="read-only"):
        trial.command[0] = 1
    with pytest.raises(TypeError):
        trial.inputs["new"] = trial.t  # type: ignore[index]


DOORS = {
    "command": lambda trial: trial.command,
    "angle": lambda trial: trial.angle,
    "swapped": lambda trial: trial.swapped(),
    "plot": lambda trial: trial.plot(),
    "page": lambda trial: trial._repr_html_(),
    "check": hystmpc.check,
    "evaluate": lambda trial: hystmpc.evaluate("builtin:pi", [trial]),
    "diagnose": lambda trial: hystmpc.diagnose([trial], "builtin:pi"),
    "write": lambda trial: write_csv(trial, "log.csv"),
}


@pytest.mark.parametrize("door", DOORS)
def test_what_works_with_one_axis_says_so_in_one_line(door: str) -> None:
    trial = two_axes().select(0, 200)
    with pytest.raises(hystmpc.HystmpcError, match=r"log.csv: a trial of 2 commands and 2 angles[^\n]*$"):
        DOORS[door](trial)

"""The Trial type: what it refuses, and that it travels between processes."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from hystmpc.trials.errors import LogError
from hystmpc.trials.trial import Trial, Units


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

"""Trials of one call have different names: results name trials."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial


def test_names_that_stand_more_than_once_get_a_number() -> None:
    t = np.arange(0.0, 4.0, 0.04)
    given = [Trial(t, t, t), Trial(t, t, t, source="a.csv"), Trial(t, t, t)]
    read = read_trials(given)
    assert [trial.source for trial in read] == ["<memory> 1", "a.csv", "<memory> 2"]
    assert read[1] is given[1]

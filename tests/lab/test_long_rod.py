"""Long catheter: its causes change it where they say, and a healthy one is found healthy."""

from __future__ import annotations

import numpy as np
import pytest

from hystmpc.trials.errors import ConfigError
from hystmpc_lab.blind.long_rod import LINES, NOISE_DEG, LongRod, missed_lines


@pytest.fixture(scope="module")
def rod() -> LongRod:
    """One drawn catheter."""
    return LongRod.drawn(3)


def test_every_cause_changes_the_angles_more_in_its_larger_size(rod: LongRod) -> None:
    healthy = np.concatenate([trial.angle for trial in rod.trials(LINES[0], 0)])
    for line in LINES[1:]:
        larger, smaller = (np.concatenate([t.angle for t in rod.trials(line, size)]) - healthy for size in (0, 1))
        assert np.std(larger) > np.std(smaller) > NOISE_DEG, line.name


def test_friction_one_way_lags_a_fall_and_leaves_a_first_rise(rod: LongRod) -> None:
    one_way = next(line for line in LINES if line.name == "friction one way")
    command = rod.commands[0]
    falls = np.flatnonzero(np.diff(command) < 0)[0]
    healthy, affected = (rod.trials(line, 0)[0].angle for line in (LINES[0], one_way))
    np.testing.assert_allclose(affected[:falls], healthy[:falls], atol=0.011)
    assert np.max(affected[falls:] - healthy[falls:]) > 1.0


def test_an_unknown_cause_is_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match="no line 'delays'"):
        missed_lines(3, ["delays"])

"""Resampling: exact on what it can know, refusing what it cannot."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.trial import MAX_GAP_S, Trial, Units, require_uniform, resample


def jittered(count: int, seed: int, start: float = 3.0) -> Trial:
    """About 100 Hz, with straight lines as signals."""
    t = start + np.cumsum(np.random.default_rng(seed).uniform(0.002, 0.018, count))
    return Trial(t, 2 * t, 5 - t, {"current": 3 * t}, Units("bar"), "log.csv")


@given(st.integers(50, 300), st.integers(0, 100), st.floats(5.0, 100.0))
def test_straight_lines_stay_straight_on_a_uniform_grid(count: int, seed: int, rate_hz: float) -> None:
    trial = jittered(count, seed)
    even = resample(trial, rate_hz)
    assert even.t[0] == trial.t[0]
    assert trial.t[-1] - 1 / rate_hz < even.t[-1] + 1e-5 / rate_hz <= trial.t[-1] + 2e-5 / rate_hz
    np.testing.assert_allclose(np.diff(even.t), 1 / rate_hz, rtol=1e-6)
    inside = even.t <= trial.t[-1]
    np.testing.assert_allclose(even.command[inside], 2 * even.t[inside])
    np.testing.assert_allclose(even.angle[inside], 5 - even.t[inside])
    np.testing.assert_allclose(even.channels["current"][inside], 3 * even.t[inside])
    assert (even.units, even.source) == (trial.units, trial.source)


def test_resampling_a_uniform_trial_at_its_own_rate_changes_nothing() -> None:
    t = np.arange(500) / 25
    trial = Trial(t, np.sin(t), np.cos(t))
    even = resample(resample(trial, 25), 25)
    assert len(even) == len(trial)
    np.testing.assert_allclose(even.command, trial.command, atol=1e-12)


def test_a_gap_is_refused_and_placed() -> None:
    trial = jittered(200, 1)
    t = trial.t + np.where(np.arange(200) >= 120, 2 * MAX_GAP_S, 0)
    gapped = Trial(t, trial.command, trial.angle, source="log.csv")
    with pytest.raises(LogError, match=rf"log\.csv: gap of 0\.4.* s from {t[119]:.6g} s \(samples 119 and 120\)"):
        resample(gapped, 20)
    assert len(resample(gapped, 20, max_gap_s=1.0)) > 1


def test_slow_logs_are_not_all_gaps() -> None:
    t = np.arange(10.0)
    assert len(resample(Trial(t, t, t), 1.0)) == 10


def test_a_rate_that_the_log_does_not_carry_is_refused() -> None:
    t = np.arange(100) / 50
    with pytest.raises(LogError, match=r"rate_hz 100, expected at most 75 .* 50 Hz"):
        resample(Trial(t, t, t), 100)
    assert len(resample(Trial(t, t, t), 74)) > 100


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_must_be_a_positive_number(rate_hz: float) -> None:
    with pytest.raises(ConfigError, match="expected a positive number"):
        resample(jittered(50, 0), rate_hz)


def test_a_trial_shorter_than_one_interval_is_refused() -> None:
    with pytest.raises(LogError, match="at least 2"):
        resample(jittered(10, 0), 1.0)


def test_uniform_means_uniform() -> None:
    assert require_uniform(resample(jittered(100, 0), 40)) == pytest.approx(1 / 40)
    with pytest.raises(LogError, match=r"log\.csv.*resample the trial first"):
        require_uniform(jittered(100, 0))

"""Resampling: exact on what it can know, refusing what it cannot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trials.check import Severity, check
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.read import at_rate, read_trials
from hystmpc.trials.trial import (
    MAX_GAP_S,
    Trial,
    Units,
    clock_advice,
    parts_at_gaps,
    require_uniform,
    resample,
)


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


def test_slow_logs_are_not_all_gaps() -> None:
    t = np.arange(10.0)
    assert len(resample(Trial(t, t, t), 1.0)) == 10


def test_a_rate_that_the_log_does_not_carry_is_refused() -> None:
    t = np.arange(100) / 50
    with pytest.raises(LogError, match=r"sampled at 50 Hz \(median\), too slow for 100 Hz, expected at most 75 Hz"):
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


@given(st.integers(0, 299), st.integers(0, 299), st.floats(0.25, 5.0))  # 300 and 300 are more than 10 %
def test_a_gap_near_an_end_costs_what_lies_beyond_it(head: int, tail: int, gap_s: float) -> None:
    t = 0.01 * np.arange(6000.0)
    t[head + 1 :] += gap_s
    t[-1 - tail :] += gap_s
    trial = Trial(t, 2 * t, t)
    (used,) = parts_at_gaps(trial)
    assert len(used) == 6000 - (head + 1) - (tail + 1)
    assert used.t[0] == t[head + 1]
    assert resample(trial, 50.0).t[0] == used.t[0]
    (gaps,) = check(trial).of("gaps")
    assert gaps.severity is Severity.NOTE
    assert f"{head + tail + 2} samples beside a gap are left out" in gaps.message


@given(st.lists(st.integers(501, 2000), min_size=1, max_size=4), st.floats(0.25, 5.0))
def test_a_log_is_cut_at_its_gaps_and_no_sample_of_a_long_part_is_lost(lengths: list[int], gap_s: float) -> None:
    t = 0.01 * np.arange(float(sum(lengths)))
    for edge in np.cumsum(lengths)[:-1]:
        t[edge:] += gap_s
    trial = Trial(t, 2 * t, -t, {"force": 3 * t}, source="log.csv")
    parts = parts_at_gaps(trial)
    assert [len(part) for part in parts] == lengths
    np.testing.assert_array_equal(np.concatenate([part.t for part in parts]), t)
    np.testing.assert_array_equal(np.concatenate([part.channels["force"] for part in parts]), 3 * t)
    assert len({part.source for part in parts}) == len(parts)
    found = at_rate([trial], 50.0)
    assert [part.source for part in found] == [part.source for part in parts]
    assert [part.t[0] for part in found] == [part.t[0] for part in parts]
    (gaps,) = check(trial).of("gaps")
    assert gaps.severity is (Severity.NOTE if len(parts) > 1 else Severity.OK)
    assert (f"cut into {len(parts)} trials" in gaps.message) == (len(parts) > 1)


def test_a_log_that_falls_to_pieces_is_refused_and_a_sound_one_is_left_as_it_is() -> None:
    t = 0.01 * np.arange(6000.0)
    (same,) = parts_at_gaps(trial := Trial(t, t, t))
    assert same is trial
    broken = t + 0.3 * (np.arange(6000) // 400)  # parts of 4 s
    with pytest.raises(LogError, match=r"gap of 0\.31 s .* in parts shorter than 5 s, expected at most 10 %"):
        at_rate([Trial(broken, t, t)], 50.0)
    assert check(Trial(broken, t, t)).worst is Severity.ERROR
    t[3000:] += 0.3
    with pytest.raises(LogError, match=r"gap of 0\.31 s from 29\.99 s .*; cut the log there"):
        resample(Trial(t, t, t), 50.0)  # one trial cannot be two


def test_a_clock_that_runs_out_of_digits_is_stood_in_for(tmp_path: Path) -> None:
    t = 0.005 * np.arange(21000.0)  # 105 s at 200 Hz
    stamps = np.array([f"{value:.5g}" for value in t])  # 100.01 s and 100.005 s read alike
    path, layout = tmp_path / "log.csv", tmp_path / "even.yaml"
    path.write_text(
        "time_s,command,angle_deg\n" + "".join(f"{s},{np.sin(v):.6f},{v:.6f}\n" for s, v in zip(stamps, t, strict=True))
    )
    with pytest.raises(LogError, match=r"expected increasing time .*`--sampled-hz 200` stands in for the broken clock"):
        read_trials(path)
    (finding,) = check(path).of("duplicates")
    assert finding.severity is Severity.ERROR
    assert "`--sampled-hz 200`" in finding.message
    layout.write_text("command: command\nangle: angle_deg\nrate_hz: 200\n")
    (trial,) = read_trials(path, str(layout))
    np.testing.assert_allclose(trial.t, t)
    for given_layout in ("auto", str(layout)):
        (again,) = read_trials(path, given_layout, sampled_hz=200)
        np.testing.assert_array_equal(again.t, trial.t)
        assert check(path, given_layout, sampled_hz=200).worst is not Severity.ERROR
    with pytest.raises(ConfigError, match="expected a positive number"):
        read_trials(path, sampled_hz=0)


def test_the_rate_of_a_clock_too_coarse_from_the_start_counts_its_repetitions() -> None:
    t = 0.01 * np.arange(3000.0)  # 100 Hz, stamps of a tenth of a second
    coarse = np.floor(10 * t + 1e-9) / 10
    assert "`--sampled-hz 100`" in clock_advice(coarse)
    back = np.where(np.arange(3000) % 50 == 49, t - 0.1, t)
    assert "`--sampled-hz 100`" in clock_advice(back)


def test_the_unit_of_the_log_is_the_unit_of_the_trial(tmp_path: Path) -> None:
    path, layout = tmp_path / "log.csv", tmp_path / "bench.yaml"
    path.write_text("t,f,x\n" + "".join(f"{k / 100},{k},{k * 1e-5}\n" for k in range(300)))
    layout.write_text("command: {signal: f, unit: N}\nangle: {signal: x, unit: m}\ntime: t\n")
    (trial,) = read_trials(path, str(layout))
    assert (trial.units.command, trial.units.angle, trial.inverted) == ("N", "m", False)
    assert trial.angle[-1] == pytest.approx(299e-5)
    assert "units of angle: 0 to 0.00299 m" in str(check(trial))
    swapped = trial.swapped()
    assert (swapped.units.command, swapped.inverted, swapped.swapped().units) == ("m", True, trial.units)
    (again,) = read_trials(write_csv(trial, tmp_path / "canonical.csv"))
    assert again.units == trial.units
    np.testing.assert_array_equal(again.angle, trial.angle)

"""Sampling, previews, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from hystmpc.trajectories import PreviewTable, Sampled, preview, sample
from hystmpc.trials.errors import TrajectoryError

LINE = Sampled(np.array([0.0, 1.0]), np.array([0.0, 10.0]))


def test_preview_looks_ahead_and_holds_the_end() -> None:
    np.testing.assert_allclose(preview(LINE, 0.8, 0.1, 4), [9.0, 10.0, 10.0, 10.0])


def test_table_slices_shift_exactly_and_cannot_be_written() -> None:
    table = PreviewTable(LINE, 0.1, 5)
    assert table.steps == 10
    for k in range(table.steps):
        np.testing.assert_array_equal(table.at(k + 1)[:-1], table.at(k)[1:])
    with pytest.raises(ValueError, match="read-only"):
        table.at(0)[0] = 1.0


def test_whole_number_of_samples_is_not_rounded_up() -> None:
    t, _ = sample(Sampled(np.array([0.0, 0.7]), np.array([0.0, 1.0])), 10.0)  # 0.7 * 10 > 7 in floating point
    assert t.size == 8


@pytest.mark.parametrize(("dt", "horizon"), [(0.0, 3), (-0.1, 3), (float("nan"), 3), (0.1, 0)])
def test_impossible_previews_are_refused(dt: float, horizon: int) -> None:
    with pytest.raises(TrajectoryError, match="expected"):
        preview(LINE, 0.0, dt, horizon)
    with pytest.raises(TrajectoryError, match="expected"):
        PreviewTable(LINE, dt, horizon)


def test_samples_before_the_start_of_the_run_are_refused() -> None:
    with pytest.raises(TrajectoryError, match="got sample -1"):
        PreviewTable(LINE, 0.1, 3).at(-1)


@pytest.mark.parametrize(
    ("t", "values", "said"),
    [
        ([0, 1], [1, 2, 3], r"\(2,\) and values \(3,\)"),
        ([0], [1], "T >= 2"),
        ([0, 1, 1], [1, 2, 3], "sample 2: got t 1 s after 1 s"),
        ([0, 1], [1, np.nan], "sample 1: got t 1.0, value nan"),
    ],
)
def test_unusable_samples_are_named(t: list[float], values: list[float], said: str) -> None:
    with pytest.raises(TrajectoryError, match=said):
        Sampled(np.array(t), np.array(values))


def test_rate_must_be_positive() -> None:
    with pytest.raises(TrajectoryError, match="rate_hz: got 0"):
        sample(LINE, 0)

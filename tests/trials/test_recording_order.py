"""Order of recording: told by one clock, or by a manifest that lists every log; else not told."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.recording import MANIFEST, WALL_CLOCK, by_clock, by_manifest, write_manifest
from hystmpc.trials.trial import Trial

NAMES = ("b.csv", "c.csv", "a.csv")


def trial(start: float, wall: float | None = None) -> Trial:
    """Ten seconds from a time on."""
    t = start + np.arange(0.0, 10.0, 0.5)
    channels = {} if wall is None else {WALL_CLOCK: 1e9 * (wall + np.arange(t.size) * 0.5)}
    return Trial(t, np.sin(t), np.cos(t), channels)


@given(st.permutations(range(5)))
def test_one_clock_tells_the_order(places: list[int]) -> None:
    found = by_clock([trial(30.0 * place) for place in places])
    assert found is not None
    assert [places[k] for k in found] == sorted(places)


def test_logs_that_begin_anew_have_no_common_clock() -> None:
    assert by_clock([trial(0.0), trial(0.0)]) is None
    assert by_clock([trial(0.0), trial(5.0)]) is None
    assert by_clock([trial(0.0, 200.0), trial(0.0, 100.0)]) == [1, 0]
    assert by_clock([trial(0.0, 200.0), trial(100.0)]) is None


def test_a_manifest_tells_the_order_of_what_it_lists(tmp_path: Path) -> None:
    assert by_manifest([str(tmp_path / name) for name in NAMES]) is None
    write_manifest(tmp_path, [tmp_path / name for name in NAMES])
    assert by_manifest([str(tmp_path / name) for name in sorted(NAMES)]) == [1, 2, 0]
    assert by_manifest([str(tmp_path / name) for name in (*NAMES, "other.csv")]) is None


def test_sessions_are_ordered_by_their_starts(tmp_path: Path) -> None:
    logs = []
    for day, folder in ((2, tmp_path / "one"), (1, tmp_path / "two")):
        folder.mkdir()
        logs.append(folder / "x.csv")
        write_manifest(folder, [logs[-1]], datetime(2026, 1, day, tzinfo=UTC))
    assert by_manifest(list(map(str, logs))) == [1, 0]


def test_another_manifest_says_nothing_and_a_broken_one_is_an_error(tmp_path: Path) -> None:
    (tmp_path / MANIFEST).write_text("format: hystmpc-dataset/1\n")
    assert by_manifest([str(tmp_path / "a.csv")]) is None
    (tmp_path / MANIFEST).write_text("format: hystmpc-recording/1\nrecorded: 3\n")
    with pytest.raises(ConfigError, match="recorded"):
        by_manifest([str(tmp_path / "a.csv")])

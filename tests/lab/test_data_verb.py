"""`hystmpc data make` as a user calls it."""

from __future__ import annotations

from pathlib import Path

import pytest

from hystmpc.trials.csv_files import read_csv
from hystmpc_lab.datasets import read_dataset

from ..cli.test_verbs import run


def test_s1_on_disk(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "s1"
    code, out, _ = run(capsys, "data", "make", "s1", "--out", folder, "--seed", 4)
    assert code == 0
    assert "26800" in out
    made = read_dataset(folder)
    assert made.seed == 4
    assert read_csv(folder / "test_a.csv").units.command == "bar"
    code, _, error = run(capsys, "data", "make", "s1", "--out", folder)
    assert code == 2
    assert "is not empty" in error


def test_unknown_set_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, error = run(capsys, "data", "make", "s9", "--out", tmp_path / "set")
    assert code == 2
    assert "no data set 's9', available: rod, s1, s2" in error
    assert not list(tmp_path.iterdir())

"""One trial is one trial, whichever program wrote it: the law of all readers, over ways of writing logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("openpyxl", reason="openpyxl (extra `logs`) is not installed")
pytest.importorskip("nptdms", reason="npTDMS (extra `logs`) is not installed")
pytest.importorskip("mcap", reason="mcap (extra `logs`) is not installed")
pytest.importorskip("rosbags", reason="rosbags (extra `logs`) is not installed")

from hystmpc.trials.check import Severity, check
from hystmpc.trials.errors import LogError
from hystmpc.trials.layouts import LogMapping
from hystmpc.trials.read import AnyLayout, read_log, read_trials

from .written_ways import MAPPED, WAYS


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, command and angle of a motion, rounded to what every way of writing keeps; thousands are among them."""
    random = np.random.default_rng(seed)
    count = int(random.integers(60, 90))
    t = np.round(0.04 * np.arange(count), 3)
    u = np.round(2.5 + 2 * np.sin(t * random.uniform(2, 4)) + 0.01 * random.random(count), 3)
    y = np.round(1e3 * np.sin(t * random.uniform(2, 4) - 0.3) - 0.5, 3)
    return t, u, y


def assert_same(path: Path, layout: AnyLayout, signals: tuple[np.ndarray, ...]) -> None:
    trial = read_log(path, layout)
    for found, written in zip((trial.t, trial.command, trial.angle), signals, strict=True):
        np.testing.assert_allclose(found, written, rtol=1e-12, atol=1e-9)
    assert (trial.units.command, trial.units.angle) == ("mm", "deg")
    assert check(path, layout).of("values")[-1].severity is not Severity.ERROR


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_trial_is_the_same_whoever_wrote_it(way: str, seed: int, tmp_path: Path) -> None:
    signals = drawn(seed)
    assert_same(WAYS[way](tmp_path, *signals), "auto", signals)


@pytest.mark.parametrize("way", MAPPED)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_mapping_file_reads_what_has_other_names(way: str, seed: int, tmp_path: Path) -> None:
    signals = drawn(seed)
    write, layout = MAPPED[way]
    assert_same(write(tmp_path, *signals), LogMapping.parse(layout), signals)


@pytest.mark.parametrize("way", ["NumPy", "TDMS", "Excel", "ROS 1", "LabVIEW"])
def test_a_folder_stands_for_its_logs_of_any_format(way: str, tmp_path: Path) -> None:
    signals = drawn(1)
    WAYS[way](tmp_path, *signals)
    (trial,) = read_trials([tmp_path])
    np.testing.assert_allclose(trial.command, signals[1], rtol=1e-12)


def test_what_other_programs_leave_beside_logs_is_no_log(tmp_path: Path) -> None:
    WAYS["Excel"](tmp_path, *drawn(1))
    (tmp_path / "~$log.xlsx").write_bytes(b"owner")
    (tmp_path / "._log.xlsx").write_bytes(b"Mac OS X")
    assert len(read_trials([tmp_path])) == 1


@pytest.mark.parametrize(("way", "package"), [("Excel", "openpyxl"), ("TDMS", "nptdms"), ("ROS 1", "rosbags")])
def test_a_missing_package_is_named_with_how_to_install_it(
    way: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = WAYS[way](tmp_path, *drawn(1))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(LogError, match=rf"needs the package {package}: pip install 'hystmpc\[logs\]'"):
        read_log(path)

"""The papers' data sets: what is in them, that seeds are kept, and that files read back."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hystmpc.models.maps import LaserConversion, TipMap
from hystmpc.trajectories.excitation import s2_sinusoid
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.trial import Trial
from hystmpc_lab.datasets import Dataset, S1Settings, S2Settings, make_dataset, read_dataset, write_dataset
from hystmpc_lab.devices.muscle import MuscleRecorder
from hystmpc_lab.devices.recorder import TendonRecorder
from hystmpc_lab.paper_commands import s1_test_b

SMALL = S2Settings(
    train_hz=(0.5,), val_hz=(0.5,), test_hz=(0.5,), train_moves=2, val_moves=1, test_moves=1, repeats=2, check_hz=(0.5,)
)


@pytest.fixture(scope="module")
def s1() -> Dataset:
    return make_dataset("s1", 0)


@pytest.fixture(scope="module")
def s2() -> Dataset:
    return make_dataset("s2", 0)


def same(a: Trial, b: Trial) -> bool:
    channels = a.channels.keys() == b.channels.keys() and all(
        np.array_equal(v, b.channels[k], equal_nan=True) for k, v in a.channels.items()
    )
    return channels and all(np.array_equal(getattr(a, k), getattr(b, k)) for k in ("t", "command", "angle"))


def test_s1_is_that_of_the_paper(s1: Dataset) -> None:
    assert {split: len(trials) for split, trials in s1.splits.items()} == {
        "train": 8, "test_a": 1, "test_b": 1, "test_c": 1, "test_d": 1
    }  # fmt: skip
    assert s1.samples["train"] == 8 * 3350  # S1: 26 798
    assert all(t.units.command == "bar" and t.dt == pytest.approx(0.004) for v in s1.splits.values() for t in v)
    assert all(t.command.min() >= 0 and t.command.max() <= 3 for v in s1.splits.values() for t in v)


def test_s1_ranges_are_near_those_of_the_paper(s1: Dataset) -> None:
    """From S1's RMSE over NRMSE: 30.8, 19.5, 21.4 deg. (b) and (c) do not agree with one static curve at 1.2 bar."""
    ranges = [float(np.ptp(s1[f"test_{k}"][0].angle)) for k in "abc"]
    assert ranges[0] == pytest.approx(30.8, abs=1.0)
    assert ranges[1] == pytest.approx(19.5, abs=4.5)
    assert ranges[2] == pytest.approx(21.4, abs=3.5)


def test_s1_angle_is_that_of_the_laser(s1: Dataset) -> None:
    """Voltages on the converter's steps; angle by eq. (2)-(4); straight is zero up to the noise of its maximum."""
    trial = s1["train"][0]
    steps = trial.channels["voltage_v"] / (10 / 2**10)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    laser = LaserConversion()
    displacement = laser.displacement(trial.angle) + laser.distance(trial.channels["voltage_v"])
    assert np.ptp(displacement) < 1e-9
    assert 0 <= np.median(trial.angle[:50]) < 0.3


def test_straight_from_the_group_itself_starts_test_b_at_zero() -> None:
    angles = [MuscleRecorder(straight=s).record(s1_test_b(), 0, "s1/test_b").angle for s in ("rest", "group")]
    assert angles[0].min() > 10.0
    assert angles[1].min() == 0.0


def test_sign_of_tau_in_test_c() -> None:
    rising, printed = (make_dataset("s1", 0, S1Settings(tau_c_per_s=tau))["test_c"][0] for tau in (-0.05, 0.05))
    assert rising.command.max() > 1.3 > 1.2 > printed.command.max()


def test_s2_is_that_of_the_paper(s2: Dataset) -> None:
    counts = {split: len(trials) for split, trials in s2.splits.items()}
    assert counts == {
        "sin/train": 12, "sin/val": 3, "sin/test": 6, "p2p/train": 15, "p2p/val": 5, "p2p/test": 20,
        "repeatability": 5, "frequency": 5,
    }  # fmt: skip
    trials = [t for v in s2.splits.values() for t in v]
    assert len({t.source for t in trials}) == len(trials)
    assert s2["p2p/test"][6].source == "s2/p2p/test_07"
    assert all(t.dt == pytest.approx(0.04) and t.units.command == "mm" for t in trials)
    assert all(27 < t.angle[0] < 32 and t.command[0] == 0 for t in trials)
    assert len({t.command.tobytes() for split in ("train", "val", "test") for t in s2[f"p2p/{split}"]}) == 40


def test_s2_tip_follows_the_published_parabola(s2: Dataset) -> None:
    t = s2["sin/train"][1]
    x, y = TipMap.fit(t.angle, t.channels["x_mm"], t.channels["y_mm"])(t.angle)
    assert np.sqrt(np.mean((x - t.channels["x_mm"]) ** 2)) < 0.4
    assert np.sqrt(np.mean((y - t.channels["y_mm"]) ** 2)) < 0.4


def test_s2_repeats_within_half_a_degree(s2: Dataset) -> None:
    """The criterion by which S2 chose its pretension; and trials are not copies of each other."""
    angles = np.array([t.angle for t in s2["repeatability"]])
    assert 0.05 < angles.std(axis=0, ddof=1).mean() < 0.5


def test_the_flexure_can_be_kept() -> None:
    cut, whole = (TendonRecorder(keep_flexure=k).record(s2_sinusoid(0.5, "0BL"), 0, "s2/x") for k in (False, True))
    assert whole.duration_s - cut.duration_s == pytest.approx(12.0)
    np.testing.assert_array_equal(whole.angle[-len(cut) :], cut.angle)
    assert whole.angle[0] == pytest.approx(20.0, abs=1.5)


def test_seeds() -> None:
    one, again, other = (make_dataset("s2", seed, SMALL) for seed in (1, 1, 2))
    for split in one.splits:
        for a, b, c in zip(one[split], again[split], other[split], strict=True):
            assert same(a, b)
            assert not np.array_equal(a.angle[:100], c.angle[:100])
    more = make_dataset("s2", 1, replace(SMALL, train_moves=3))
    assert same(more["p2p/train"][0], one["p2p/train"][0])


def test_files_read_back(tmp_path: Path) -> None:
    made = make_dataset("s2", 3, SMALL)
    write_dataset(made, tmp_path / "new" / "set")
    back = read_dataset(tmp_path / "new" / "set")
    assert (back.name, back.seed, list(back.splits)) == ("s2", 3, list(made.splits))
    assert back.settings == made.settings
    assert back.settings["recorder"]["device"]["loading_slope"] == 10.7
    for split in made.splits:
        for a, b in zip(made[split], back[split], strict=True):
            assert same(a, b)
            assert a.source == b.source
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["set"]


def test_nothing_is_overwritten_or_half_written(tmp_path: Path) -> None:
    made = make_dataset("s2", 0, SMALL)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match=r"is not empty \(notes.txt\)"):
        write_dataset(made, tmp_path / "full")

    def stopped(done: int, total: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_dataset(made, tmp_path / "stopped", stopped)
    assert [p.name for p in tmp_path.iterdir()] == ["full"]
    (tmp_path / "empty").mkdir()
    assert (write_dataset(made, tmp_path / "empty") / "p2p" / "train_01.csv").exists()


def test_a_damaged_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_dataset(tmp_path)
    (tmp_path / "manifest.yaml").write_text("format: other/1\n")
    with pytest.raises(ConfigError, match="format 'other/1'"):
        read_dataset(tmp_path)
    (tmp_path / "manifest.yaml").write_text("format: hystmpc-dataset/1\n")
    with pytest.raises(ConfigError, match="not a manifest"):
        read_dataset(tmp_path)
    folder = write_dataset(make_dataset("s2", 0, SMALL), tmp_path / "set")
    file = folder / "p2p" / "val_01.csv"
    file.write_text("".join(file.read_text().splitlines(keepends=True)[:-5]))
    with pytest.raises(LogError, match=r"val_01\.csv: got \d+ samples, expected \d+ as the manifest says"):
        read_dataset(folder)


def test_a_data_set_travels_to_a_worker() -> None:
    made = make_dataset("s2", 0, SMALL)
    assert same(pickle.loads(pickle.dumps(made))["p2p/val"][0], made["p2p/val"][0])


def test_wrong_names() -> None:
    with pytest.raises(ConfigError, match="no data set 's3', available: rod, s1, s2"):
        make_dataset("s3")
    with pytest.raises(ConfigError, match="seed: got -1"):
        make_dataset("s1", -1)
    with pytest.raises(ConfigError, match="got S1Settings, expected S2Settings"):
        make_dataset("s2", 0, S1Settings())
    with pytest.raises(ConfigError, match=r"no split 'p2p/tests'.*did you mean 'p2p/test'"):
        make_dataset("s2", 0, SMALL)["p2p/tests"]
    with pytest.raises(ConfigError, match="check_offset"):
        S2Settings(check_offset="0bl")  # type: ignore[arg-type]

"""A commissioning as a whole: interrupted and gone on with, stopped and latched, from logs alone, refused."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hystmpc
from hystmpc.bench import motions
from hystmpc.bench.commission import NAMES, commission_logs, rewrite_report
from hystmpc.bench.config import CommissionSettings, located_commission
from hystmpc.bench.device import DeviceStoppedError
from hystmpc.bench.identify import Subject
from hystmpc.bench.motions import CONTROLLERS
from hystmpc.bench.stages import EndedEarlyError
from hystmpc.rig.run import reset_latch
from hystmpc.trials.config import dump_yaml, load_settings
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.errors import ConfigError, LogError

from ..cli.test_verbs import run
from .small_commission import BENCH, commissioned, make_quick, settings, within

DEVICE_STAGES = (NAMES[0], NAMES[1], NAMES[6])


def results(out: Path) -> dict[str, Any]:
    """All results, trials and tracks of a folder, by name."""
    found = {str(f.relative_to(out)): f.read_bytes() for f in sorted(out.rglob("*.csv"))}
    return found | {str(f.relative_to(out)): json.loads(f.read_text()) for f in sorted(out.rglob("result.json"))}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[float]]:
    """The folder of a commissioning that nothing has interrupted, and every command that the device got."""
    with pytest.MonkeyPatch.context() as patch:
        make_quick(patch)
        folder, sent = tmp_path_factory.mktemp("whole"), list[float]()
        commissioned(settings(folder), folder / "run", sent)
    return folder / "run", sent


@pytest.mark.slow
def test_a_device_becomes_a_controller(whole: tuple[Path, list[float]]) -> None:
    out, sent = whole
    assert within(sent, settings(out))
    assert all((out / name / "result.json").exists() for name in NAMES if name != "5-diagnose")
    html = (out / "report.html").read_text(encoding="utf-8")
    assert "<svg" in html
    assert "http://" not in html.replace("http://www.w3.org", "")
    verified = json.loads((out / NAMES[6] / "result.json").read_text())["result"]
    assert set(verified["scores"]) == set(CONTROLLERS)
    assert all(score["beyond"] == 0 for score in verified["scores"].values())
    tip = hystmpc.TipController.from_config(out / "tip.yaml")
    tip.set_target(50.0)
    assert 0.0 <= tip.step(30.0).u <= 10.0 * tip.dt
    spent = json.loads((out / "device_time.json").read_text())["seconds"]
    assert spent <= 60.0 * settings(out).commission.minutes


# Commands after which each call is interrupted, as a share of those of a whole commissioning, and how.
INTERRUPTED = ((0.05, "killed"), (0.2, "signal"), (0.35, "killed"), (0.5, "killed"))


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_interrupted_again_and_again_it_goes_on_to_the_same_result(
    whole: tuple[Path, list[float]], tmp_path: Path
) -> None:
    """At any command of the device: nothing complete is lost or repeated, and what comes after is the same."""
    bench, kept = settings(tmp_path), dict[Path, int]()
    for share, how in INTERRUPTED:
        sent, at = list[float](), max(round(share * len(whole[1])), 1)

        def angle(k: int, u: float, y: float, at: int = at, how: str = how) -> float:
            if k == at and how == "killed":
                raise KeyboardInterrupt
            if k == at:
                signal.raise_signal(signal.SIGINT)
            return y

        with pytest.raises(KeyboardInterrupt if how == "killed" else DeviceStoppedError):
            commissioned(bench, tmp_path / "run", sent, angle)
        assert within(sent, bench)
        assert kept == {f: f.stat().st_mtime_ns for f in kept}
        kept = {f: f.stat().st_mtime_ns for f in sorted((tmp_path / "run").rglob("*.csv"))}
        with pytest.raises(ConfigError, match="latched"):
            commissioned(bench, tmp_path / "run", sent, angle)
        reset_latch(bench)
    after = list[float]()  # a computed device begins anew at rest
    commissioned(bench, tmp_path / "run", after)
    assert results(tmp_path / "run") == results(whole[0])
    assert {f.parent.parent.name for f in kept} == {NAMES[1], NAMES[6]}
    assert kept == {f: f.stat().st_mtime_ns for f in kept}
    assert within(after, bench)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_a_complete_one_moves_nothing_more_and_other_settings_are_refused(
    whole: tuple[Path, list[float]], tmp_path: Path
) -> None:
    bench, sent = settings(whole[0].parent), list[float]()
    assert commissioned(bench, whole[0], sent).verified is not None
    assert sent == []
    again = hystmpc.commission(BENCH | {"latch_file": str(bench.latch_file)}, whole[0])
    assert again.tip == whole[0] / "tip.yaml"
    other = settings(whole[0].parent, commission={"seed": 2})
    with pytest.raises(ConfigError, match=r"begun with commission\.seed 1, now it is 2"):
        commissioned(other, whole[0], sent)
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match="is not empty"):
        commissioned(bench, tmp_path / "foreign", sent)
    assert sent == []


def test_the_report_is_written_again_and_nothing_else(
    whole: tuple[Path, list[float]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From what lies in the folder; what lacks a stage is said, not done."""
    run_folder = tmp_path / "run"
    shutil.copytree(whole[0], run_folder)
    before = (run_folder / "report.html").read_text(encoding="utf-8")
    (run_folder / "report.html").unlink()
    kept = {f: f.read_bytes() for f in run_folder.rglob("*") if f.is_file()}
    assert run(capsys, "report", run_folder)[0] == 0
    again = (run_folder / "report.html").read_text(encoding="utf-8")
    assert [text in again for text in before.split("<svg")[0].splitlines()].count(False) == 0
    assert {f: f.read_bytes() for f in kept} == kept
    assert run(capsys, "report", run_folder, "--before", run_folder)[0] == 2
    (run_folder / NAMES[3] / "result.json").unlink()
    code, _, said = run(capsys, "report", run_folder)
    assert (code, "expected a complete commissioning" in " ".join(said.split())) == (2, True)
    assert not (run_folder / NAMES[3] / "result.json").exists()


@pytest.mark.usefixtures("quick")
def test_a_sensor_that_dies_stops_safely_and_keeps_what_was_complete(tmp_path: Path) -> None:
    bench, sent, dies = settings(tmp_path), list[float](), 700

    def angle(k: int, u: float, y: float) -> float:
        return float("nan") if dies <= k < 1200 else y

    with pytest.raises(DeviceStoppedError, match="sensor dead"):
        commissioned(bench, tmp_path / "run", sent, angle)
    assert sent[-1] == pytest.approx(0.0, abs=1e-9)
    assert within(sent, bench)
    trials = sorted((tmp_path / "run" / NAMES[1] / "trials").glob("*.csv"))
    assert trials
    assert all(np.isfinite(read_csv(trial).angle).all() for trial in trials)
    assert not (tmp_path / "run" / NAMES[1] / "result.json").exists()


@pytest.mark.parametrize(
    ("gain", "expected"), [(0.0, "the angle moved by"), (-8.0, "falls as the command rises"), (60.0, "% of the limits")]
)
def test_a_device_that_cannot_be_commissioned_is_said(gain: float, expected: str, tmp_path: Path) -> None:
    """A blocked tip, a wrong sign, a tip that leaves its limits at once; the watch on motion is off."""
    bench, sent = settings(tmp_path, plausibility={"watch_motion": False}), list[float]()

    def angle(k: int, u: float, y: float) -> float:
        return min(max(80.0 + gain * u + 1e-6 * (k % 5), 0.0), 120.0)

    with pytest.raises(EndedEarlyError, match=expected):
        commissioned(bench, tmp_path / "run", sent, angle)
    assert within(sent, bench)


@pytest.mark.usefixtures("quick")
@pytest.mark.slow
@pytest.mark.parametrize("with_bench", [True, False])
def test_logs_alone_end_before_the_verification(
    whole: tuple[Path, list[float]], with_bench: bool, tmp_path: Path
) -> None:
    logs = shutil.copytree(whole[0] / NAMES[1] / "trials", tmp_path / "logs")
    bench = settings(tmp_path) if with_bench else None
    found = commission_logs([logs], tmp_path / "run", bench and bench.model_copy())
    assert found.verified is None
    assert not (tmp_path / "run" / NAMES[6]).exists()
    assert "nothing was verified" in found.report.read_text(encoding="utf-8")
    tip = hystmpc.TipController.from_config(found.tip)
    assert tip.dt == pytest.approx(0.04)
    assert commission_logs([logs], tmp_path / "run", bench).model == found.model
    found.report.unlink()
    assert rewrite_report(tmp_path / "run").report.exists()
    changed = sorted(logs.glob("*.csv"))[0]
    changed.write_text("".join(changed.read_text().splitlines(keepends=True)[:-1]))
    with pytest.raises(LogError, match="expected the recordings that it was made from"):
        rewrite_report(tmp_path / "run")


def test_recordings_keep_to_a_range_that_is_narrower_than_the_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The range ends where the tip comes near its angle limit; no recording goes farther."""
    monkeypatch.setattr(motions, "LEAST_SHARE", 0.05)

    def refused(subject: Subject) -> None:
        raise LogError("far enough")

    monkeypatch.setattr("hystmpc.bench.commission.check_trials", refused)
    bench, sent = settings(tmp_path, commission={"angle_limits_deg": [20.0, 60.0]}), list[float]()
    with pytest.raises(EndedEarlyError, match="far enough"):
        commissioned(bench, tmp_path / "run", sent)
    found = json.loads((tmp_path / "run" / NAMES[0] / "result.json").read_text())["result"]
    assert 1.2 < found["upper"] < 5.0
    trials = [read_csv(file) for file in (tmp_path / "run" / NAMES[1] / "trials").glob("*.csv")]
    assert len(trials) == 6
    assert max(trial.command.max() for trial in trials) <= found["upper"] + 1e-9


def test_a_stage_is_not_gone_on_with_after_another_range(whole: tuple[Path, list[float]], tmp_path: Path) -> None:
    """Recordings, model and controller belong to the range that they were made in."""
    shutil.copytree(whole[0], tmp_path / "run")
    file, sent = tmp_path / "run" / NAMES[0] / "result.json", list[float]()
    data = json.loads(file.read_text())
    data["result"]["upper"] -= 1.0
    file.write_text(json.dumps(data))
    with pytest.raises(ConfigError, match="was begun after other results"):
        commissioned(settings(whole[0].parent), tmp_path / "run", sent)
    assert sent == []


def test_wrong_settings_are_one_line(tmp_path: Path) -> None:
    def loaded(**changes: Any) -> CommissionSettings:
        (tmp_path / "bench.yaml").write_text(dump_yaml(BENCH | changes))
        return located_commission(load_settings(CommissionSettings, tmp_path / "bench.yaml"), tmp_path)

    assert loaded(latch_file="latch.json").latch_file == tmp_path / "latch.json"
    for changes, expected in (
        ({"commission": {"minutes": 6}}, "minutes"),
        ({"commission": {"minuets": 3}}, "minutes"),
        ({"commission": {"angle_limits_deg": [10, 130]}}, "within the sensor's 0 to 120"),
        ({"controller": {}}, "controller"),
        ({"sensor": {"kind": "none", "rest_deg": 30}}, "got sensor.kind none, expected continuous"),
        ({"sensor": BENCH["sensor"] | {"kind": "intermittent"}}, "got sensor.kind intermittent, expected continuous"),
    ):
        with pytest.raises(ConfigError, match=expected) as caught:
            loaded(**changes)
        assert "\n" not in str(caught.value)

"""Any verb on any wrong file: one line, exit code 2, nothing left behind; the name of a right file does not matter."""

from __future__ import annotations

import html
import json
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from hystmpc.models.simulator import ChainModel, export_simulator, save_simulator
from hystmpc.sim.compare import compare
from hystmpc.sim.config import SimulationConfig
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.trial import Trial

from ..models.zoo import CHAINS, simulator
from ..sim.small import SCAN, study_data
from .test_verbs import run

POSIX = pytest.mark.skipif(os.name == "nt", reason="users and file names are those of POSIX")
LEFT = ("new", "new.yaml", "new.onnx", "new.json")


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Right files, and wrong ones of every ending."""
    folder = tmp_path_factory.mktemp("desk")
    model = ChainModel(simulator(CHAINS["backlash"], dt=0.04))
    t = np.arange(0, 10, 0.04)
    command = 3 - 3 * np.cos(0.6 * np.pi * t)
    angle = model.run(command, 23.0) + np.random.default_rng(0).normal(0, 0.1, t.size)
    write_csv(Trial(t, command, angle), folder / "trial.csv")
    save_simulator(simulator(CHAINS["backlash"]), folder / "sim.yaml")
    export_simulator(simulator(CHAINS["backlash"]), folder / "model.onnx")
    noise = np.random.default_rng(1).bytes(3000)
    for ending in ("csv", "yaml", "onnx", "mcap", "mat", "db3"):
        (folder / f"folder.{ending}").mkdir()
        (folder / f"empty.{ending}").touch()
        (folder / f"binary.{ending}").write_bytes(noise)
        if ending != "csv":
            shutil.copy(folder / "trial.csv", folder / f"trial.{ending}")
    shutil.copy(folder / "sim.yaml", folder / "sim.csv")
    shutil.copy(folder / "model.onnx", folder / "model.csv")
    shutil.copy(folder / "model.onnx", folder / "model.yaml")
    (folder / "list.yaml").write_text("- 1\n- 2\n")
    (folder / "number.yaml").write_text("3\n")
    return folder


WRONG_LOGS = [
    *(f"{what}.{ending}" for what in ("folder", "empty", "binary") for ending in ("csv", "mcap", "mat", "db3")),
    *("trial.mcap", "trial.mat", "trial.db3", "sim.csv", "model.csv", "sim.yaml", "absent.csv", "x" * 300 + ".csv"),
]
WRONG_YAML = [
    *("folder.yaml", "empty.yaml", "binary.yaml", "trial.yaml", "model.yaml", "list.yaml", "number.yaml"),
    *("trial.csv", "model.onnx", "absent.yaml", "x" * 300 + ".yaml"),
]
WRONG_MODELS = [*WRONG_YAML, "folder.onnx", "empty.onnx", "binary.onnx", "trial.onnx", "absent.onnx"]
WRONG_FOLDERS = ["trial.csv", "folder.csv", "absent", "x" * 300]
EVERY_VERB = [
    (["evaluate", "sim.yaml", "{}"], WRONG_LOGS),
    (["fit", "backlash", "{}", "--out", "new.yaml"], WRONG_LOGS),
    (["diagnose", "{}", "--sim", "sim.yaml", "--out", "new"], WRONG_LOGS),
    (["study", "real", "--quick", "--logs", "{}", "--out", "new"], WRONG_LOGS),
    (["gap", "blind", "ablate", "{}", "--sim", "sim.yaml", "--out", "new"], WRONG_LOGS),
    (["gap", "blind", "make", "--seed", "1", "--suite", "injection", "--logs", "{}", "--out", "new"], WRONG_LOGS),
    (["evaluate", "{}", "trial.csv"], [name for name in WRONG_MODELS if name != "model.onnx"]),
    (["diagnose", "trial.csv", "--sim", "{}", "--out", "new"], [name for name in WRONG_MODELS if name != "model.onnx"]),
    (["gap", "blind", "ablate", "trial.csv", "--sim", "{}", "--out", "new"], WRONG_MODELS),
    (["export", "{}", "--out", "new.onnx"], WRONG_MODELS),
    (["simulate", "{}", "--out", "new"], WRONG_YAML),
    (["simulate", "--sweep", "{}", "--out", "new"], WRONG_YAML),
    (["simulate", "sim.yaml", "--controller", "a={}", "--out", "new"], WRONG_YAML),
    (["tune", "{}", "--out", "new"], WRONG_YAML),
    (["run", "{}", "--out", "new"], WRONG_YAML),
    (["record", "{}", "--out", "new"], WRONG_YAML),
    (["device", "{}"], WRONG_YAML),
    (["evaluate", "sim.yaml", "trial.csv", "--layout", "{}"], WRONG_YAML),
    (["report", "{}"], WRONG_FOLDERS),
    (["simulate", "--row", "{}", "405c"], WRONG_FOLDERS),
    (["gap", "blind", "run", "{}"], WRONG_FOLDERS),
    (["gap", "blind", "score", "{}"], WRONG_FOLDERS),
    (["gap", "blind", "record", "{}", "001", "trial.csv"], WRONG_FOLDERS),
]


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line with which a call ends."""
    code, _, err = run(capsys, *arguments)
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert (code, len(lines)) == (2, 1), f"{arguments}: {code}, {err}"
    return lines[0]


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "wrong"), EVERY_VERB, ids=[" ".join(words) for words, _ in EVERY_VERB])
def test_a_wrong_file_is_one_line(
    arguments: list[str],
    wrong: list[str],
    desk: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(desk)
    for name in wrong:
        refused(capsys, *(word.replace("{}", name) for word in arguments))
        assert not any((desk / left).exists() for left in LEFT), name


@pytest.mark.parametrize("name", WRONG_LOGS)
def test_a_check_goes_on_or_ends_with_one_line(
    name: str, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(desk)
    code, out, err = run(capsys, "check", name)
    assert code in (1, 2)
    assert "error" in out + err
    assert "Traceback" not in err


@POSIX
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may become another user")
@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "wrong"), EVERY_VERB, ids=[" ".join(words) for words, _ in EVERY_VERB])
def test_a_file_that_may_not_be_read_is_one_line(
    arguments: list[str], wrong: list[str], desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As another user, in a folder of root; what a verb imports it has imported before."""
    with tempfile.TemporaryDirectory() as place:
        shutil.copytree(desk, place, dirs_exist_ok=True)
        here = os.getcwd()
        try:
            os.chdir(place)
            refused(capsys, *(word.replace("{}", wrong[0]) for word in arguments))
            target = "trial.csv" if wrong is WRONG_LOGS else "sim.yaml" if wrong is not WRONG_FOLDERS else "folder.csv"
            os.chmod(place, 0o777)
            os.chmod(target, 0)
            os.seteuid(65534)
            refused(capsys, *(word.replace("{}", target) for word in arguments))
        finally:
            os.seteuid(0)
            os.chdir(here)


NAMES = [
    "a b",
    "50%s %d",
    "$x$ \\frac{",
    "q'\"`uote",
    "naïve-ß-日本",
    "[red]",
    "[/x]",
    ":smile:",
    "{0}{note}",
    "<b>&amp;",
]
ALL = "$x$ \\frac{1}$ 50%s q'\"` naïve 日本 [red] [:smile:] {0} <b>&amp; -"


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("name", NAMES)
def test_a_file_is_called_as_it_is(
    name: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).parent.mkdir(exist_ok=True)
    shutil.copy(desk / "trial.csv", f"{name}.csv")
    shutil.copy(desk / "sim.yaml", f"{name}.yaml")
    code, out, _ = run(capsys, "check", f"{name}.csv")
    assert code == 0
    assert f"{name}.csv" in " ".join(out.split())
    assert run(capsys, "evaluate", f"{name}.yaml", f"{name}.csv", "--json", f"{name}.json")[0] == 0
    assert json.loads(Path(f"{name}.json").read_text())["trials"][0]["file"] == Path(f"{name}.csv").name
    code, out, _ = run(capsys, "export", f"{name}.yaml", "--out", f"{name}.onnx")
    assert code == 0
    assert f"{name}.onnx" in out
    assert f"{name}.absent.csv: no such file" in refused(capsys, "evaluate", f"{name}.yaml", f"{name}.absent.csv")


@POSIX
@pytest.mark.slow
def test_a_fit_and_a_study_with_such_names(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(desk / "trial.csv", f"{ALL}.csv")
    assert run(capsys, "fit", "backlash", f"./{ALL}.csv", "--out", f"{ALL}.yaml")[0] == 0
    changes = {"plant": {"simulator": f"{ALL}.yaml"}, "model": f"{ALL}.yaml", "motions": {"scan": SCAN}}
    data = study_data(**changes, controllers={"pid": {"kind": "pid"}})
    Path(f"{ALL}.study.yaml").write_text(yaml.safe_dump(data, allow_unicode=True), encoding="utf-8")
    code, out, err = run(capsys, "simulate", f"./{ALL}.study.yaml", "--out", ALL)
    assert code == 0, err
    assert f"report: {ALL}/report.html" in out
    report = Path(ALL, "report.html")
    assert f"{ALL}.yaml" in html.unescape(report.read_text(encoding="utf-8"))
    report.unlink()
    code, out, _ = run(capsys, "report", f"./{ALL}")
    assert (code, report.is_file()) == (0, True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a study with one run."""
    folder = tmp_path_factory.mktemp("run") / "whole"
    data = study_data(motions={"scan": SCAN}, controllers={"inverse": {"kind": "inverse"}})
    compare(SimulationConfig.parse(data), folder)
    return folder


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def noise(file: Path) -> None:
    file.write_bytes(np.random.default_rng(1).bytes(500))


def empty(file: Path) -> None:
    file.write_bytes(b"")


def a_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


def other_content(file: Path) -> None:
    file.write_text({".json": '{"format": "hystmpc-run/1"}', ".yaml": "a: 1\n", ".csv": "a,b\n1,2\n3,4\n"}[file.suffix])


@pytest.mark.slow
@pytest.mark.parametrize("damage", [cut, noise, empty, a_folder, other_content])
@pytest.mark.parametrize("name", ["meta.json", "config.yaml", "scan/inverse/log.csv", "scan/inverse/meta.json"])
def test_a_damaged_run_folder_is_one_line(
    name: str, damage: Callable[[Path], None], whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    (folder / "report.html").unlink()
    damage(folder / name)
    code, _, err = run(capsys, "report", folder)
    if code == 0:  # a log cut off at its end is still a log
        assert (name, damage) == ("scan/inverse/log.csv", cut)
        return
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert (code, len(lines)) == (2, 1), err
    assert not (folder / "report.html").exists()

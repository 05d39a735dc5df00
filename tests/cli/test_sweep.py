"""`hystmpc simulate --sweep`, `--row`, `--controller` and `hystmpc tune` as a user calls them."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from hystmpc.sim import jobs
from hystmpc.sim.results import load_results
from hystmpc.sim.sweep.settings import load_sweep
from hystmpc.sim.sweep.table import table_of
from hystmpc.sim.tuning.settings import TuneSettings, complete
from hystmpc.trials.config import dump_yaml, load_settings

from ..sim.small import SCAN, study_data
from .test_verbs import run, shown_until

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
BASE = study_data(motions={"scan": SCAN}, controllers={"pid": {"kind": "pid"}})
SWEEP: dict[str, Any] = {"base": BASE, "draw": {"plant.lag_s": {"uniform": [0.0, 0.1]}}, "count": 3}


def written(folder: Path, data: Any, name: str = "settings.yaml") -> Path:
    path = folder / name
    path.write_text(dump_yaml(data), encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_sweep_and_a_row_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = written(tmp_path, SWEEP), tmp_path / "sweep"
    arguments = ["simulate", "--sweep", file, "--out", folder, "--jobs", 1]
    code, out, err = run(capsys, *arguments)
    assert code == 0, err
    assert "3 runs, 0 of them from before, 0 failed" in out
    code, out, _ = run(capsys, *arguments, "--set", "count=4")
    assert "4 runs, 3 of them from before, 0 failed" in out
    identity = str(table_of(folder, ["id"])["id"][0])
    code, out, _ = run(capsys, "simulate", "--row", folder, identity, "--out", tmp_path / "run")
    assert code == 0
    assert "NO" not in out
    assert len(load_results(tmp_path / "run").results) == 1


@pytest.mark.slow
def test_a_row_that_comes_out_otherwise_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = written(tmp_path, SWEEP | {"count": 1}), tmp_path / "sweep"
    assert run(capsys, "simulate", "--sweep", file, "--out", folder, "--jobs", 1)[0] == 0
    table = table_of(folder, ["id", "rmse_deg"])
    identity, error = str(table["id"][0]), float(table["rmse_deg"][0] or 0.0)
    assert repr(error) in (folder / "runs.csv").read_text(encoding="utf-8")
    with closing(sqlite3.connect(folder / "runs.db")) as base, base:
        base.execute("UPDATE runs SET figures = replace(figures, ?, ?)", (repr(error), repr(error * (1 + 1e-15))))
    code, out, err = run(capsys, "simulate", "--row", folder, identity)
    assert code == 1
    assert "NO" in out
    assert "came out otherwise" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["simulate"], "expected one of CONFIG, --sweep FILE and --row DIR ID"),
        (["simulate", "{file}", "--sweep", "{file}", "--out", "x"], "expected one of CONFIG"),
        (["simulate", "--sweep", "{file}"], "no --out"),
        (["simulate", "--sweep", "{file}", "--out", "x", "--set", "gird={}"], "did you mean 'grid'"),
        (["simulate", "--sweep", "{file}", "--out", "x", "--set", "draw.plant={}"], "expected one of uniform"),
        (["simulate", "--sweep", "{file}", "--out", "x", "--cluster", "here"], "expected `local` or an address"),
        (["simulate", "--row", "nowhere", "0123"], "no table of runs"),
        (["simulate", "{file}", "--out", "x", "--controller", "tuned"], "expected NAME=FILE"),
        (["simulate", "{file}", "--out", "x", "--controller", "tuned={file}"], "expected the settings of one"),
        (["tune", "nowhere.yaml", "--out", "x"], "nowhere.yaml"),
        (["simulate", "--sweep", "{file}", "--out", "x", "--jobs", "0"], "--jobs: got 0, expected 1 or more"),
        (["tune", "{file}", "--out", "x", "--jobs", "-3"], "--jobs: got -3, expected 1 or more"),
        (["simulate", "{file}", "--out", "x", "--jobs", "2"], "--jobs does nothing here, expected it with --sweep"),
        (["simulate", "{file}", "--out", "x", "--cluster", "local"], "--cluster does nothing here"),
        (["simulate", "--sweep", "{file}", "--out", "x", "--controller", "a={file}"], "--controller does nothing here"),
        (["simulate", "--sweep", "{file}", "--out", "x", "--set", "base.model=builtin:pie"], "did you mean 'pi'"),
        (["tune", "{file}", "--out", "x"], "unknown key 'count'"),
    ],
)
def test_unusable_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = written(tmp_path, SWEEP)
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, *(word.replace("{file}", str(file)) for word in arguments))
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert code == 2
    assert len(lines) == 1
    assert message in lines[0]
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_an_unknown_built_in_model_is_told_with_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study, sweep = written(tmp_path, BASE | {"model": "builtin:pie"}, "study.yaml"), tmp_path / "sweep.yaml"
    written(tmp_path, SWEEP | {"base": BASE | {"plant": {"simulator": "builtin:tendn-catheter"}}}, "sweep.yaml")
    for arguments, place in (
        (["simulate", study], f"{study}, line 3: model: no built-in model 'pie'"),
        (["simulate", "--sweep", sweep], f"{sweep}, line 3: plant.simulator: no built-in model 'tendn-catheter'"),
    ):
        code, _, err = run(capsys, *arguments, "--out", tmp_path / "x")
        assert code == 2
        assert f"error: {place}" in err
    assert not (tmp_path / "x").exists()


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["simulate", "tune"])
def test_a_cluster_that_does_not_answer_leaves_nothing_behind(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="dask is an extra")
    pytest.importorskip("optuna", reason="optuna is an extra")
    monkeypatch.setattr(jobs, "_TIMEOUT_S", 0.5)
    folder, search = tmp_path / "x", {"base": BASE, "draw": SWEEP["draw"]}
    what = ["--sweep", written(tmp_path, SWEEP)] if verb == "simulate" else [written(tmp_path, search)]
    code, _, err = run(capsys, verb, *what, "--out", folder, "--cluster", "tcp://127.0.0.1:9")
    assert code == 2
    assert "--cluster tcp://127.0.0.1:9: no Dask scheduler answers" in err
    assert not folder.exists()


@pytest.mark.slow
def test_a_sweep_that_was_another_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "sweep"
    for lag in (0.0, 0.05):
        file = written(tmp_path, {"base": BASE | {"actuator_lag_s": lag}})
        code, out, err = run(capsys, "simulate", "--sweep", file, "--out", folder, "--jobs", 1)
        assert code == 0, err
    assert "1 more rows are of another form of this sweep" in out


@pytest.mark.slow
def test_a_tuning_does_not_go_on_in_anothers_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("optuna", reason="optuna is an extra")
    few = {"plants": {"count": 1, "seed": 1}, "held_out": {"count": 1, "seed": 2}, "trials": 1}
    file, folder = written(tmp_path, {"base": BASE, "draw": SWEEP["draw"]} | few), tmp_path / "tune"
    arguments = ["tune", file, "--out", folder, "--jobs", 1]
    assert run(capsys, *arguments)[0] == 0
    kept = (folder / "controller.yaml").read_bytes()
    code, _, err = run(capsys, *arguments, "--set", "seed=7")
    assert code == 2
    assert "holds a tuning with other seed, expected a new folder" in err
    assert (folder / "controller.yaml").read_bytes() == kept
    assert run(capsys, *arguments, "--set", "trials=2")[0] == 0


def test_the_examples_are_right() -> None:
    from hystmpc.sim.sweep.plan import SweepPlan

    file = EXAMPLES / "sweep.yaml"
    assert SweepPlan(load_sweep(file), file).check() == 200
    file = EXAMPLES / "tune.yaml"
    assert complete(load_settings(TuneSettings, file), file).controller == "linearised_mpc"


@pytest.mark.slow
def test_a_tuned_controller_goes_into_a_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("optuna", reason="optuna is an extra")
    plants = {"plants": {"count": 2, "seed": 1}, "held_out": {"count": 2, "seed": 2}, "trials": 3}
    folder = tmp_path / "tune"
    tuned = written(tmp_path, {"base": BASE, "draw": SWEEP["draw"]} | plants)
    code, out, err = run(capsys, "tune", tuned, "--out", folder, "--jobs", 1)
    assert code == 0, err
    assert "2 plants that the search has not seen" in out
    study = written(tmp_path, BASE, "study.yaml")
    added = f"tuned={folder / 'controller.yaml'}"
    code, out, err = run(capsys, "simulate", study, "--out", tmp_path / "run", "--controller", added)
    assert code == 0, err
    assert load_results(tmp_path / "run").controllers == ("pid", "tuned")
    assert run(capsys, "simulate", folder / "study.yaml", "--out", tmp_path / "both")[0] == 0


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")
def test_ctrl_c_leaves_a_sweep_that_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = written(tmp_path, SWEEP | {"count": 2000}), tmp_path / "sweep"
    arguments = ["simulate", "--sweep", str(file), "--out", str(folder), "--jobs", "2"]
    program = "import sys; from hystmpc.cli.main import main; sys.argv = ['hystmpc', *sys.argv[1:]]; main()"
    screen, terminal = os.openpty()
    process = subprocess.Popen([sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, stderr=terminal)
    os.close(terminal)
    while process.poll() is None and not table_of(folder, ["id"])["id"]:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    seen = shown_until(screen, "goes on")
    process.communicate(timeout=60)
    os.close(screen)
    assert process.returncode == 130, seen[-300:]
    kept = [str(identity) for identity in table_of(folder, ["id"])["id"]]
    assert 1 <= len(kept) == len(set(kept)) < 2000
    assert not list(folder.glob("runs.db?*"))
    code, out, _ = run(capsys, *arguments[:-1], "1", "--set", f"count={len(kept)}")
    assert code == 0
    assert "0 failed" in out
    assert set(kept) <= {str(identity) for identity in table_of(folder, ["id"])["id"]}

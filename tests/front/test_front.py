"""The front door: its names are there, light, documented and typed, and one call follows from another."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import hystmpc
from hystmpc.trials.csv_files import write_csv

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ["hystmpc", *(f"hystmpc.{room}" for room in ("trials", "models", "trajectories", "sim", "rig"))]


@pytest.fixture(scope="module")
def trials() -> list[hystmpc.Trial]:
    """Three trials of the simulator that ships, 20 s each, with a little noise."""
    model, random = hystmpc.load_model("builtin:tendon-catheter"), np.random.default_rng(0)
    t, made = np.arange(0, 20, 0.04), []
    for k, hz in enumerate((0.2, 0.3, 0.25)):
        u = 3 - 2.5 * np.cos(2 * np.pi * hz * t) * np.exp(-0.02 * t)
        angle, x = np.empty(t.size), model.initial(np.array([[30.0]]))
        for i, command in enumerate(u):
            x = model.step(x, np.array([[command]]))
            angle[i] = model.output(x)[0, 0]
        made.append(hystmpc.Trial(t, u, angle + random.normal(0, 0.05, t.size), source=f"made_{k}.csv"))
    return made


@pytest.fixture(scope="module")
def pi(trials: list[hystmpc.Trial]) -> hystmpc.Fit:
    return hystmpc.fit("pi", trials, limits=hystmpc.Limits(0, 6, 12))


@pytest.mark.parametrize("package", PACKAGES)
def test_every_name_is_there_and_known_to_a_type_checker(package: str) -> None:
    module = importlib.import_module(package)
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    guards = [n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    typed = {a.asname or a.name for g in guards for n in g.body if isinstance(n, ast.ImportFrom) for a in n.names}
    renamed = {
        ast.unparse(n.value): ast.unparse(n.targets[0]) for g in guards for n in g.body if isinstance(n, ast.Assign)
    }
    assert set(module.__all__) - {"__version__"} == {renamed.get(name, name) for name in typed}
    assert [name for name in module.__all__ if getattr(module, name, None) is None] == []
    assert not hasattr(module, "nothing_of_this_name")


def test_every_name_says_what_it_does() -> None:
    assert set(dir(hystmpc)) == set(hystmpc.__all__)
    assert hystmpc.__version__ == version("hystmpc")
    for name in set(hystmpc.__all__) - {"__version__"}:
        assert inspect.getdoc(getattr(hystmpc, name)), name
        assert name in hystmpc.__all__


def test_importing_it_loads_nothing() -> None:
    code = "import sys, hystmpc; print(*sorted(m for m in sys.modules if m.partition('.')[0] in sys.argv))"
    heavy = ["numpy", "scipy", "casadi", "onnx", "matplotlib", "pydantic", "pandas", "typer"]
    done = subprocess.run([sys.executable, "-c", code, *heavy], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


@pytest.mark.slow
def test_from_trials_to_a_controller(pi: hystmpc.Fit, trials: list[hystmpc.Trial], tmp_path: Path) -> None:
    evaluation = hystmpc.evaluate(pi, trials)
    assert len(evaluation) == 3
    assert evaluation.mean.rmse_deg < 0.3
    files = [write_csv(trial, tmp_path / trial.source) for trial in trials]
    saved = hystmpc.evaluate(pi.save(tmp_path / "pi.yaml"), tmp_path)
    assert [run.errors for run in saved] == [run.errors for run in evaluation]
    assert hystmpc.evaluate(pi.simulator, files)[2].errors == evaluation[2].errors
    assert hystmpc.export(tmp_path / "pi.yaml", tmp_path / "a.onnx") == hystmpc.export(pi, tmp_path / "b.onnx")
    exported = hystmpc.evaluate(hystmpc.load_model(tmp_path / "b.onnx"), trials[0])[0]
    np.testing.assert_allclose(exported.theta, evaluation[0].theta, atol=1e-6)
    controller = hystmpc.build_controller("linearised_mpc", pi, limits=hystmpc.Limits(0, 5, 10))
    command, _ = controller.step(controller.init(41.0, 0.0), 41.2, np.full(controller.horizon, 50.0))
    assert (command.u, command.source) == (pytest.approx(10 * 0.04), "mpc")
    tip = {"model": str(tmp_path / "pi.yaml"), "controller": {"kind": "inverse"}}
    assert hystmpc.TipController.from_config(tip).dt == 0.04


def test_what_cannot_be_done_is_said(pi: hystmpc.Fit, trials: list[hystmpc.Trial], tmp_path: Path) -> None:
    for call, text in (
        (lambda: hystmpc.fit("pj", trials), "no kind of model 'pj'"),
        (lambda: hystmpc.build_controller("mpc", pi), "available: inverse"),
        (lambda: hystmpc.build_controller("pid", pi, limits=hystmpc.Limits(-9, 9, 1)), "made for"),
        (lambda: hystmpc.load_model("builtin:pj"), "no built-in model 'pj'"),
        (lambda: hystmpc.export(tmp_path / "absent.yaml", tmp_path / "a.onnx"), "absent.yaml"),
        (lambda: hystmpc.evaluate(pi, tmp_path), "no *.csv"),
        (lambda: hystmpc.evaluate(pi, []), "no logs given"),
    ):
        with pytest.raises(hystmpc.HystmpcError, match=text.replace("*", r"\*")):
            call()


def test_progress_is_told(trials: list[hystmpc.Trial]) -> None:
    calls: list[tuple[float, float, str]] = []
    found = hystmpc.fit("backlash", trials[:1], progress=lambda done, total, note="": calls.append((done, total, note)))
    assert calls
    assert calls[-1][2].startswith("best ")
    calls.clear()
    hystmpc.evaluate(found, trials, progress=lambda done, total, note="": calls.append((done, total, note)))
    assert [call[:2] for call in calls] == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.slow
def test_a_notebook_shows_what_a_person_would_look_at(pi: hystmpc.Fit, trials: list[hystmpc.Trial]) -> None:
    for shown in (trials[0], pi, hystmpc.evaluate(pi, trials)):
        assert isinstance(shown.plot(), Figure)
        assert "<table" in shown._repr_html_()
        assert 'src="data:image/png;base64,' in shown._repr_html_()
    report = hystmpc.check(trials[0])
    assert "excitation" in str(report)
    assert "<table" in report._repr_html_()


@pytest.mark.slow
def test_a_study_and_a_tuning(tmp_path: Path) -> None:
    scan = {
        "kind": "scan_sinusoid",
        "start_deg": 45,
        "centre_deg": 50,
        "amplitude_deg": 5,
        "frequency_hz": 1,
        "cycles": 1,
    }
    study = {
        "plant": {"simulator": "builtin:tendon-catheter"},
        "model": "builtin:pi",
        "motions": {"scan": scan},
        "controllers": {"inverse": {"kind": "inverse"}},
    }
    found = hystmpc.simulate(study, tmp_path / "run")
    assert (tmp_path / "run" / "report.html").is_file()
    tuned = hystmpc.tune(
        {"base": study, "trials": 2, "plants": {"count": 2, "seed": 1}, "held_out": {"count": 2, "seed": 2}},
        tmp_path / "tuning",
    )
    for shown in (found, tuned):
        assert isinstance(shown.plot(), Figure)
        assert "<table" in shown._repr_html_()


@pytest.mark.slow
def test_a_diagnosis(pi: hystmpc.Fit, trials: list[hystmpc.Trial], tmp_path: Path) -> None:
    found = hystmpc.diagnose(trials, pi, only=("lag", "delay"), out=tmp_path / "diagnosis")
    assert found.verdict in ("none", "too_little", "unknown")
    assert (tmp_path / "diagnosis" / "report.html").is_file()
    assert isinstance(found.plot(), Figure)
    assert found.reason[:20] in found._repr_html_()
    again = hystmpc.diagnose(trials, pi.save(tmp_path / "pi.yaml"), only=("lag", "delay"))
    assert json.dumps(again.as_json()) == json.dumps(found.as_json())  # nan is not equal to nan

"""`hystmpc diagnose` as a user calls it: what it refuses, and what it prints."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import hystmpc
from hystmpc.cli import diagnose
from hystmpc.ctrl.command import CommandLimits
from hystmpc.gap.next.motion_design import Noise, propose, write_motion
from hystmpc.gap.next.motions import menu
from hystmpc.models.simulator import ChainModel, Residual, load_simulator, save_simulator
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import LogError
from hystmpc.trials.trial import Trial

from ..gap.contenders import DELAY, LAG
from ..gap.report_examples import REASON, VERDICTS, report_data
from ..models.zoo import CHAINS, simulator
from .test_verbs import run


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A log, a simulator, a taken folder and a motion that was proposed."""
    folder = tmp_path_factory.mktemp("inputs")
    t = np.arange(0, 10, 0.04)
    command = 3 - 3 * np.cos(0.8 * np.pi * t)
    trial = Trial(t, command, 20 + 10 * command)
    proposal = propose((LAG, DELAY), menu(CommandLimits(0.0, 6.0, 12.0), 0.04), Noise(0.1))
    (folder / "taken").mkdir()
    (folder / "taken" / "thesis.tex").write_text("years of work")
    return {
        "log": str(write_csv(trial, folder / "sine.csv")),
        "sim": str(save_simulator(simulator(CHAINS["backlash"]), folder / "sim.yaml")),
        "taken": str(folder / "taken"),
        "milliseconds": str(write_csv(Trial(1000 * t, command, 20 + 10 * command), folder / "ms.csv")),
        "planned": str(write_motion(folder / "next_motion.csv", proposal)),
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "lacks LOG..., --out"),
        (["{log}"], "lacks --out"),
        (["{log}", "--sim", "{sim}"], "lacks --out"),
        (["{log}", "--sim", "absent.yaml", "--out", "out"], "absent.yaml"),
        (["{log}", "--sim", "sim.pkl", "--out", "out"], "expected .yaml, .onnx or builtin:NAME"),
        (["{log}", "--sim", "{log}", "--out", "out"], "ending .csv"),
        (["absent.csv", "--sim", "{sim}", "--out", "out"], "absent.csv"),
        (["{log}", "--sim", "{sim}", "--out", "{taken}"], "holds no diagnosis"),
        (["{log}", "--sim", "{sim}", "--out", "{log}"], "is a file"),
        (["{log}", "{planned}", "--sim", "{sim}", "--out", "out"], "is a motion proposed by a diagnosis"),
        (["{log}", "--sim", "{sim}", "--out", "out", "--layout", "tendon"], "tendon-catheter"),
        (
            ["{log}", "{milliseconds}", "--sim", "{sim}", "--out", "out"],
            "time_s runs from 0 to 9960, sampling rate 0.025 Hz, expected 1 Hz to 20 kHz: is it in milliseconds?",
        ),
    ],
)
def test_unusable_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    message: str,
    inputs: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "diagnose", *(word.format(**inputs) for word in arguments))
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert code == 2
    assert len(lines) == 1
    assert message in lines[0]
    assert out == ""
    assert list(tmp_path.iterdir()) == [], "nothing may stay behind"


@pytest.mark.parametrize("call", ["fit", "evaluate", "diagnose"])
def test_a_proposed_motion_is_no_recording_in_python_either(call: str, inputs: dict[str, str], tmp_path: Path) -> None:
    """Refused before anything is computed or written, whoever takes it for a log."""
    calls: dict[str, Callable[[], object]] = {
        "fit": lambda: hystmpc.fit("pi", [inputs["planned"]]),
        "evaluate": lambda: hystmpc.evaluate(inputs["sim"], [inputs["planned"]]),
        "diagnose": lambda: hystmpc.diagnose([inputs["log"], inputs["planned"]], inputs["sim"], out=tmp_path / "d"),
    }
    with pytest.raises(LogError, match=r"next_motion\.csv: is a motion proposed by a diagnosis, expected what was"):
        calls[call]()
    assert list(tmp_path.iterdir()) == []


def test_one_function_makes_the_whole_diagnosis() -> None:
    """The steps that make a folder with a tracking gap stand in one file; every caller calls its function."""
    root, steps = Path(hystmpc.__file__).parent, ("with_tracking(", "save_diagnosis(")
    files = [*root.glob("*.py"), *root.glob("[a-z]*/**/*.py")]
    sources = {p.relative_to(root).as_posix(): p.read_text(encoding="utf-8") for p in files}
    own = {name: text for name, text in sources.items() if not name.startswith(("tests/", ".", "build/"))}
    callers = {n for n, text in own.items() if any(re.search(rf"(?<!def ){re.escape(s)}", text) for s in steps)}
    assert callers == {"gap/diagnose.py"}
    whole = {"tasks/diagnose.py", "bench/identify.py", "bench/rounds.py"}
    assert whole <= {name for name, text in own.items() if "diagnose_trials(" in text}


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_console_says_verdict_size_and_next_motion(
    verdict: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    diagnosis = next(e for e in (report_data(v, 3) for v in VERDICTS if v == verdict)).diagnosis
    monkeypatch.setattr(diagnose, "out", Console(width=200))
    diagnose.print_diagnosis(diagnosis)
    shown = " ".join(capsys.readouterr().out.split())
    assert REASON[verdict] in shown
    assert "RMSE" in shown
    assert ("next: record next_motion.csv" in shown) == (diagnosis.next_motion is not None)
    for effect in diagnosis.effects:
        assert all(name in shown for name in effect.parameters)


@pytest.mark.slow
def test_json_is_all_of_standard_output_and_the_folder_is_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    random, model = np.random.default_rng(3), ChainModel(simulator(CHAINS["backlash"]))
    logs = []
    for k, hz in enumerate((0.2, 0.3, 0.2)):
        t = np.arange(0, 12, 0.04)
        command = (3 - 0.4 * k) * (1 - np.cos(2 * np.pi * hz * t))
        angle = 1.05 * model.run(command, 23.0) + random.normal(0, 0.2, t.size)
        logs.append(write_csv(Trial(t, command, angle), tmp_path / f"sine_{k}.csv"))
    sim = save_simulator(simulator(CHAINS["backlash"]), tmp_path / "sim.yaml")
    code, out, err = run(capsys, "diagnose", *logs, "--sim", sim, "--out", tmp_path / "d", "--json")
    assert code == 0, err
    assert out == (tmp_path / "d" / "diagnosis.json").read_text(encoding="utf-8")
    found = json.loads(out)
    assert found["format"] == "hystmpc-diagnosis/3"
    assert found["verdict"] in VERDICTS
    files = {path.name for path in (tmp_path / "d").iterdir()}
    assert {"config.yaml", "meta.json", "log.csv", "diagnosis.json", "report.html", "sim.fixed.yaml"} <= files
    assert ("next_motion.csv" in files) == (found["next_motion"] is not None)
    page = html.unescape((tmp_path / "d" / "report.html").read_text(encoding="utf-8"))
    assert page.count(f"<p>{found['reason']}</p>") == 1


def test_a_check_with_a_simulator_says_what_the_logs_would_show(
    inputs: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(capsys, "check", inputs["log"], "--sim", inputs["sim"])
    said = " ".join(out.split())
    assert (code, "model-form error is unknown" in said) == (0, True)
    known = load_simulator(Path(inputs["sim"]))
    residual = Residual(log="other.csv", motion="continuous", samples=99, rmse_deg=0.3, bias_deg=0.0, lag_one=0.5)
    identified = known.identification.model_copy(update={"residuals": (residual,)})
    path = save_simulator(replace(known, identification=identified), Path(inputs["sim"]).parent / "known.yaml")
    code, out, _ = run(capsys, "check", inputs["log"], "--sim", path)
    assert code == 0
    assert "These logs would show" in out
    assert "tau_s" in next(line for line in out.splitlines() if line.strip().startswith("lag "))
    code, out, err = run(capsys, "check", inputs["log"], "--sim", inputs["log"])
    assert (code, out) == (2, ""), "a wrong simulator is refused before anything else"
    assert "ending .csv" in err


def test_help_names_the_options(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    code, out, _ = run(capsys, "diagnose", "--help")
    assert code == 0
    options = ("--sim", "--out", "--layout", "--json", "--seed", "--without", "--only", "--ordered", "--self-test")
    for option in (*options, "--skip-first-flexure"):
        assert option in out

"""The verbs as a user calls them: on good logs, on bad input, and stopped half way."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hystmpc.cli.main import main
from hystmpc.cli.models import limits_line
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.csv_files import read_csv, write_csv
from hystmpc.trials.trial import Trial

from ..models.zoo import CHAINS, simulator


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of one call."""
    before = sys.argv
    sys.argv = ["hystmpc", *map(str, arguments)]
    try:
        main()
    except SystemExit as end:
        code = int(end.code or 0)
    else:
        code = 0
    finally:
        sys.argv = before
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two decaying sinusoids of a simulated device, recorded at 100 Hz with noise."""
    folder = tmp_path_factory.mktemp("logs")
    model = ChainModel(simulator(CHAINS["pi"], dt=0.01))
    rng, paths = np.random.default_rng(0), []
    for frequency in (0.2, 0.4):
        t = np.arange(0, 7 / frequency, 0.01)
        decay = np.exp(-frequency / 6 * np.log(7) * t)
        u = 3 * decay * (np.sin(2 * np.pi * frequency * t - np.pi / 2) + 1)
        trial = Trial(t, u, model.run(u, 23.0) + rng.normal(0, 0.1, t.size))
        paths.append(write_csv(trial, folder / f"sinusoid_{frequency}.csv"))
    return paths


def test_radians_are_pointed_out_and_fitted_all_the_same(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trial = read_csv(logs[1])
    wrong = write_csv(Trial(trial.t, trial.command, np.radians(trial.angle)), tmp_path / "radians.csv")
    code, _, err = run(capsys, "fit", "backlash", wrong, "--out", tmp_path / "sim.yaml")
    assert code == 0
    assert "radians.csv: units of angle" in err
    assert "looks like radians, expected deg" in err
    code, _, err = run(capsys, "fit", "backlash", logs[1], "--out", tmp_path / "right.yaml")
    assert (code, "warning" in err) == (0, False)


def test_from_logs_to_an_exported_model(logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """check, fit, evaluate and export, one after the other, as the page on fitting has them."""
    assert run(capsys, "check", *logs)[0] == 0
    code, out, _ = run(capsys, "fit", "backlash", *logs, "--out", tmp_path / "sim.yaml", "--command-limits", 0, 6)
    assert code == 0
    assert "mean" in out
    code, out, _ = run(capsys, "export", tmp_path / "sim.yaml", "--out", tmp_path / "model.onnx")
    assert code == 0
    assert "1000 steps" in out
    figures = {}
    for model in ("sim.yaml", "model.onnx"):
        found = tmp_path / f"{model}.json"
        assert run(capsys, "evaluate", tmp_path / model, *logs, "--json", found)[0] == 0
        figures[model] = json.loads(found.read_text())
    assert figures["sim.yaml"]["format"] == "hystmpc-evaluation/1"
    assert [row["file"] for row in figures["sim.yaml"]["trials"]] == [log.name for log in logs]
    assert figures["sim.yaml"]["mean"]["rmse_deg"] == pytest.approx(figures["model.onnx"]["mean"]["rmse_deg"], abs=1e-9)
    assert 0.05 < figures["sim.yaml"]["mean"]["rmse_deg"] < 2.0


def test_a_folder_of_logs_and_both_ways_to_count(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, _ = run(capsys, "fit", "pi", logs[0].parent, "--plays", 3, "--out", tmp_path / "pi.yaml")
    assert code == 0
    for extra in ([], ["--skip-first-flexure"]):
        code, out, _ = run(capsys, "evaluate", tmp_path / "pi.yaml", logs[0].parent, *extra)
        assert code == 0
        assert "hold drift" in " ".join(out.split())


def test_the_clock_that_check_proposes_is_one_that_check_fit_and_evaluate_take(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken, model = tmp_path / "broken.csv", tmp_path / "model.yaml"
    header, *rows = logs[1].read_text().splitlines()
    rows = [",".join([f"{float(row.split(',')[0]):.2g}", *row.split(",")[1:]]) for row in rows]  # 10.1 s reads 10 s
    broken.write_text("\n".join([header, *rows]) + "\n")
    code, out, _ = run(capsys, "check", broken)
    assert (code, "--sampled-hz 100" in " ".join(out.replace("│", " ").split())) == (1, True)
    assert run(capsys, "fit", "backlash", broken, "--out", model)[0] == 2
    given = (broken, "--sampled-hz", 100)
    assert run(capsys, "check", *given)[0] == 0
    assert run(capsys, "fit", "backlash", *given, "--out", model)[0] == 0
    found = [tmp_path / f"{name}.json" for name in ("broken", "sound")]
    assert run(capsys, "evaluate", model, *given, "--json", found[0])[0] == 0
    assert run(capsys, "evaluate", model, logs[1], "--json", found[1])[0] == 0
    one, other = (json.loads(file.read_text())["mean"] for file in found)
    assert one == pytest.approx(other, rel=1e-6)


@pytest.mark.slow
def test_a_fit_is_scored_on_trials_that_it_did_not_see_and_drawn(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sim, page = tmp_path / "sim.yaml", tmp_path / "fit.html"
    fit = ["fit", "backlash", logs[0], "--out", sim, "--command-limits", 0, 3]
    code, out, err = run(capsys, *fit, "--test", logs[1], "--report", page)
    assert code == 0
    assert "on 1 trial that it was identified from" in out
    assert "warning: the logs' commands go from 0" in err
    unseen = next(line for line in out.splitlines() if line.endswith("on 1 trial that the fit did not see."))
    code, out, _ = run(capsys, "evaluate", sim, logs[1], "--report", tmp_path / "evaluation.html")
    assert code == 0
    assert unseen.removesuffix(" that the fit did not see.") + "." in out
    for made in (page, tmp_path / "evaluation.html"):
        html = made.read_text()
        assert "<svg" in html
        assert 'src="' not in html
        assert logs[1].name in html
    assert logs[0].name in page.read_text()
    assert "limits" not in run(capsys, *fit[:4], tmp_path / "b.yaml", "--command-limits", 0, 6)[2]


NO_LOG = "missing.csv"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["check", NO_LOG], NO_LOG),
        (["fit", "backlash", NO_LOG, "--out", "sim.yaml"], NO_LOG),
        (["fit", "backlash", "{log}", "--out", "sim.txt"], "expected a file ending in .onnx or .yaml"),
        (["fit", "lstm", "{log}", "--out", "net.yaml"], "expected a file ending in .onnx"),
        (["fit", "lstm", "{log}", "--training", "papers", "--out", "net.onnx"], "did you mean 'paper'"),
        (["fit", "backlash", "{log}", "--layout", "tendon", "--out", "sim.yaml"], "tendon-catheter"),
        (["fit", "backlash", "{log}", "--rate-hz", "5000", "--out", "sim.yaml"], "too slow for 5000 Hz"),
        (["fit", "backlash", "{log}", "--command-limits", "6", "0", "--out", "sim.yaml"], "--command-limits"),
        (["fit", "backlash", "{log}", "--test", "{log}", "--out", "sim.yaml"], "is one of the logs of the fit"),
        (["fit", "pi", "{log}", "--test", "a.csv", "b.csv", "--out", "sim.yaml"], "b.csv stands behind --test"),
        (["evaluate", "model.pkl", "{log}"], "expected a model file"),
        (["evaluate", "absent.onnx", "{log}"], "absent.onnx"),
        (["export", "{log}", "--out", "model.onnx"], "expected"),
        (["report", "nowhere"], "nowhere"),
        (["simulate", "nowhere.yaml", "--out", "run"], "nowhere.yaml"),
    ],
)
def test_unusable_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    message: str,
    logs: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, *(word.replace("{log}", str(logs[0])) for word in arguments))
    errors = [line for line in err.splitlines() if line.startswith("error: ")]
    if arguments[0] == "check":  # a check reports what is wrong with a log and goes on to the next
        assert code in (1, 2)
    else:
        assert code == 2
        assert len(errors) == 1
        assert message in errors[0]
    assert list(tmp_path.iterdir()) == [], "nothing may stay behind"


def test_an_unknown_verb_or_option_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "fitt")[0] == 2
    assert run(capsys, "fit", "spline", "log.csv", "--out", "x.yaml")[0] == 2


def test_help_names_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, "--help")
    for verb in ("check", "fit", "evaluate", "export", "simulate", "report", "demo", "bench"):
        assert verb in out


def shown_until(screen: int, text: str, seconds: float = 120.0) -> str:
    """What a terminal shows until `text` appears on it, the program ends or time is up."""
    shown, deadline = "", time.monotonic() + seconds
    while text not in shown and time.monotonic() < deadline:
        if select.select([screen], [], [], 1.0)[0]:
            try:
                shown += os.read(screen, 4096).decode(errors="replace")
            except OSError:  # the other end is closed
                break
    return shown


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")
def test_ctrl_c_during_training_keeps_the_best_so_far(logs: list[Path], tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is an extra")
    target = tmp_path / "net.onnx"
    arguments = ["fit", "lstm", str(logs[1]), "--rate-hz", "10", "--out", str(target), "--epochs", "100000"]
    program = "import sys; from hystmpc.cli.main import main; sys.argv = ['hystmpc', *sys.argv[1:]]; main()"
    screen, terminal = os.openpty()  # a progress bar is only drawn on a terminal
    process = subprocess.Popen(
        [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, stderr=terminal, text=True
    )
    os.close(terminal)
    try:
        seen = shown_until(screen, "best ")
        process.send_signal(signal.SIGINT)
        seen += shown_until(screen, "interrupted")
        out, _ = process.communicate(timeout=120)
    finally:
        process.kill()  # a training that did not end would go on for hours
        os.close(screen)
    assert process.returncode == 0, seen
    assert "interrupted" in seen
    assert target.exists()
    assert "mean" in out


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (DeviceLimits(), "as seen in the logs; give --command-limits and --command-rate for the device's own"),
        (DeviceLimits(Range(lower=0.0, upper=5.0)), "the rate as seen in the logs; give --command-rate"),
        (DeviceLimits(None, 9.0), "the range as seen in the logs; give --command-limits for"),
        (DeviceLimits(Range(lower=0.0, upper=5.0), 9.0), "as given"),
    ],
)
def test_a_fit_says_where_the_limits_come_from_that_controllers_will_keep(given: DeviceLimits, expected: str) -> None:
    """What was recorded may be more, or less, than the device may be sent."""
    stored = ChainModel(simulator(CHAINS["pi"], dt=0.01)).metadata
    line, box = limits_line(stored, given), stored.command_limits
    assert line.startswith(f"limits stored in the model: {box.lower:.4g} to {box.upper:.4g} mm, at most ")
    assert expected in line
    assert len(line) < 300

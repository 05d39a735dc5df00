"""`hystmpc study` as a user calls it."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hystmpc.trials.csv_files import write_csv

from ..cli.test_verbs import run, shown_until
from .study_examples import small_trial


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three logs of a simulated device."""
    folder = tmp_path_factory.mktemp("logs")
    return [write_csv(small_trial(f"log{k}", 0.5 * k), folder / f"log{k}.csv") for k in range(3)]


@pytest.mark.slow
def test_leave_one_out_over_logs(logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "real"
    arguments = ["study", "real", "--logs", logs[0].parent, "--kinds", "pi", "--presets", "best", "--quick"]
    code, out, err = run(capsys, *arguments, "--out", folder, "--jobs", 1)
    assert code == 0, err
    assert "6 jobs done, 0 failed" in out
    assert "6 of 6 jobs to do" in err
    rows = list(csv.DictReader((folder / "tables" / "real_forward_later.csv").open()))
    assert {row["model"] for row in rows} == {"PI (best)", "backlash (best)"}
    ratios = {row["model"]: float(row["over the backlash's"]) for row in rows}
    assert ratios["backlash (best)"] == 1.0
    assert ratios["PI (best)"] < 1.0  # the device is a Prandtl-Ishlinskii model
    page = (folder / "report.html").read_text()
    assert all(f"log{k}.csv" in page for k in range(3))
    assert "Real logs" in page
    assert "simulated" not in page.lower()
    code, out, err = run(capsys, *arguments, "--out", folder, "--jobs", 1)
    assert code == 0
    assert "0 of 6 jobs to do" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["real"], "expected at least two with --logs"),
        (["real", "--logs", "absent"], "absent"),
        (["s2", "--logs", "some.csv"], "expected none"),
        (["s2", "--kinds", "fnn,lstn"], "did you mean 'lstm'"),
        (["s1", "--presets", "papers"], "did you mean 'paper'"),
        (["s2", "--stages", "windows"], "did you mean 'window'"),
        (["s2", "--directions", "up"], "directions"),
    ],
)
def test_unusable_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, "study", *arguments, "--out", "study")
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert code == 2
    assert len(lines) == 1
    assert message in lines[0]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")
def test_ctrl_c_keeps_what_is_done_and_says_so(logs: list[Path], tmp_path: Path) -> None:
    folder = tmp_path / "real"
    arguments = ["study", "real", "--logs", str(logs[0].parent), "--kinds", "backlash,pi"]
    arguments += ["--presets", "paper", "--out", str(folder), "--jobs", "2"]
    program = "import sys; from hystmpc.cli.main import main; sys.argv = ['hystmpc', *sys.argv[1:]]; main()"
    screen, terminal = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, stderr=terminal, text=True
    )
    os.close(terminal)
    while process.poll() is None and not list((folder / "results").glob("*.json")):
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    seen = shown_until(screen, "goes on")
    process.communicate(timeout=60)
    os.close(screen)
    assert process.returncode == 130, seen
    assert "interrupted" in seen
    assert list((folder / "results").glob("*.json"))
    assert not (folder / "report.html").exists()

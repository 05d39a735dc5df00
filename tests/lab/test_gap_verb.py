"""`hystmpc gap blind` as a user calls it: what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystmpc.models.simulator import save_simulator
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.trial import Trial

from ..cli.test_verbs import run
from ..models.zoo import CHAINS, simulator


@pytest.fixture
def log(tmp_path: Path) -> str:
    """A log of three slow cycles."""
    t = np.arange(0, 10, 0.04)
    command = 3 - 3 * np.cos(0.6 * np.pi * t)
    return str(write_csv(Trial(t, command, 20 + 10 * command), tmp_path / "log.csv"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["make", "--out", "new", "--seed", "1", "--suite", "injection"], "got no logs"),
        (["make", "--out", "new", "--seed", "1", "--logs", "{log}", "--layout", "bench"], "unknown layout 'bench'"),
        (["ablate", "{log}", "--sim", "{core}", "--out", "new"], "the simulator is a core without effects"),
        (["ablate", "{log}", "--sim", "{core}", "--out", "{taken}"], "is not empty"),
        (["ablate", "absent.csv", "--sim", "{core}", "--out", "new"], "absent.csv: no such file"),
        (["run", "{taken}"], "expected the manifest"),
    ],
)
def test_what_cannot_be_done_ends_with_one_line(
    arguments: list[str],
    message: str,
    log: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    core = str(save_simulator(simulator(CHAINS["backlash"]), tmp_path / "core" / "sim.yaml"))
    names = {"log": log, "core": core, "taken": str(tmp_path / "core")}
    code, _, err = run(capsys, "gap", "blind", *(word.format(**names) for word in arguments))
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert code == 2
    assert len(lines) == 1
    assert message in lines[0]
    assert not (tmp_path / "new").exists()

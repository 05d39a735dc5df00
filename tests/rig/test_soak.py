"""The soak, as short as it can be: two processes over UDP, the sleeper beside them, the same run in process."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from hystmpc.rig.safety.stop import StopFlag
from hystmpc_lab.faults.forked import Forked

from ..scripts import script
from .forked import forked

__all__ = ["forked"]


def test_the_sleeper_counts_what_came_later_than_a_period() -> None:
    wake_ups = np.array([[0.0, 0.0], [0.04, 0.039], [0.08, 0.041], [0.2, 0.1]])
    found = script("bare_loop").floor(wake_ups, 25.0)
    assert (found.wake_ups, found.late, found.greatest_s) == (4, 2, 0.1)


def test_a_loop_that_is_busy_for_longer_than_a_period_is_late_every_time() -> None:
    loop = script("bare_loop")
    wake_ups = loop.sleep_on(100.0, 0.2, StopFlag(), busy_s=0.012)
    assert 0 < len(wake_ups) <= 10
    assert loop.floor(wake_ups, 100.0).late == len(wake_ups)


@pytest.mark.slow
@pytest.mark.usefixtures("forked")
def test_a_soak_of_seconds(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether a deadline was missed is the machine's affair; that the figures and the exit code agree is ours."""
    soak = script("soak")
    words = ["--rate", "50", "--faster", "2", "--minutes", "0.02", "--transport", "udp", "--blocks", "1,2,4,8"]
    places = ["--json", str(tmp_path / "soak.json"), "--out", str(tmp_path / "runs")]
    monkeypatch.setattr(sys, "argv", ["soak.py", *words, *places])
    monkeypatch.setattr(soak, "start", Forked)
    code = soak.main()
    (row,) = json.loads((tmp_path / "soak.json").read_text(encoding="utf-8"))
    for run in (row["wire"], row["in_process"]):
        assert run["ended"] == ""
        assert run["samples"] > 50
        assert run["sources"]["mpc"] > 30
        assert 0 < run["tracking_deg"] < 5
        assert 0 <= run["beside_stall"] <= run["missed"] <= run["samples"]
        assert 0 < run["execution"]["least_s"] <= run["execution"]["greatest_s"]
        assert run["refused"] == []
        assert run["execution"]["median_s"] <= run["execution"]["p99_s"] <= run["execution"]["greatest_s"]
        assert 0.5 * run["samples"] < run["floor"]["wake_ups"] < 1.5 * run["samples"]
    assert row["ratio"] == pytest.approx(row["wire"]["tracking_deg"] / row["in_process"]["tracking_deg"])
    assert 0 <= row["spinner"]["late"] <= row["spinner"]["wake_ups"] <= 101
    assert "move_blocking" in (tmp_path / "runs" / "udp-50hz" / "run.yaml").read_text(encoding="utf-8")
    assert (code == 0) == row["passed"] == (row["wire"]["missed"] == 0 and row["ratio"] <= 1.1)
    assert "udp 50 Hz" in capsys.readouterr().out

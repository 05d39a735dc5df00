"""The verb `analyse` as a user calls it."""

from __future__ import annotations

from pathlib import Path

import pytest

import hystmpc

from .test_verbs import run

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def test_a_tip_that_rests_is_analysed_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, text, _ = run(capsys, "analyse", EXAMPLES / "tip.yaml", "--out", tmp_path / "out")
    assert code == 0
    assert "linearised_mpc: settles in" in text
    assert (tmp_path / "out" / "report.html").read_text(encoding="utf-8").count("<svg") == 2


def test_a_loop_that_oscillates_ends_with_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tip = tmp_path / "tip.yaml"
    tip.write_text(
        "model: builtin:backlash\nactuator_lag_s: 0.2\ncontroller: {kind: pid, gains: {ki_per_deg_s: 1.5}}\n"
    )
    code, text, errors = run(capsys, "analyse", tip, "--set", "controller.gains.dead_zone_deg=0.0")
    assert code == 1
    assert "limit cycle of" in text
    assert "too great for a hold: pid" in errors
    (one,) = hystmpc.analyse(tip, overrides=["controller.gains.dead_zone_deg=0.0"], tolerance_deg=90.0).controllers
    assert one.cycle is not None
    assert one.too_great is False

"""`hystmpc commission` as a user calls it: what is said beforehand, exit codes, and a device behind a real socket."""

from __future__ import annotations

import json
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest

import hystmpc
from hystmpc.studies.faults.play import end, start_device
from hystmpc.trials.config import dump_yaml

from ..cli.test_verbs import run
from .small import BENCH, SCAN

DEVICE = {
    "rate_hz": 25,
    "command_unit": "mm",
    "plant": {"simulator": "builtin:tendon-catheter", "lag_s": 0.08, "noise_deg": 0.1},
    "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
    "link": {"kind": "udp", "bind_port": 0},
    "watchdog_s": 0.5,
    "seed": 1,
}


def written(folder: Path, **changes: Any) -> Path:
    """A bench file."""
    data = BENCH | {"latch_file": "latch.json"} | changes
    file = folder / "bench.yaml"
    file.write_text(dump_yaml(data))
    return file


def test_the_plan_is_said_and_nothing_is_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The example, from the repository."""
    example = Path(__file__).resolve().parents[2] / "examples" / "commission.yaml"
    code, said, _ = run(capsys, "commission", example, "--dry-run", "--out", tmp_path / "run")
    assert code == 0
    words = " ".join(said.split())
    assert "limits: command 0 to 6 mm at 10 mm/s, angle 10 to 110 deg" in words
    assert "1-range" in words
    assert "7-verify" in words
    total = float(words.split("all ")[1].split()[0])
    assert 3.0 < total <= 5.0
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "lacks CONFIG"),
        (["bench"], "lacks --out"),
        (["bench", "--set", "commission.minutes=9", "--out", "run"], "less than or equal to 5"),
        (["bench", "--set", "commission.minutes=0.2", "--out", "run"], "expected more minutes"),
        (["--logs", "none.csv", "--out", "run"], "no such file"),
        (["--logs", "none.csv", "--set", "seed=2", "--out", "run"], "--set does nothing without CONFIG"),
    ],
)
def test_what_is_refused_is_one_line(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = written(tmp_path)
    places = {"bench": bench, "run": tmp_path / "run", "none.csv": tmp_path / "none.csv"}
    code, _, said = run(capsys, "commission", *(places.get(text, text) for text in arguments))
    assert code == 2
    assert expected in " ".join(said.split())
    assert not (tmp_path / "run").exists()


def test_a_stage_that_cannot_be_completed_ends_with_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench = written(tmp_path, commission=BENCH["commission"] | {"angle_limits_deg": [60, 110]})
    code, _, said = run(capsys, "commission", bench, "--out", tmp_path / "run")
    assert code == 1
    assert "expected at least 20 % of the limits" in " ".join(said.split())


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_over_udp_ctrl_c_keeps_what_is_complete_and_the_same_command_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In real time: about a minute of motion."""
    from hystmpc.commissioning import motions

    monkeypatch.setattr(motions, "_REST_S", 0.3)
    monkeypatch.setattr(motions, "_RECORD_SHARE", 0.75)
    (tmp_path / "device.yaml").write_text(dump_yaml(DEVICE))
    process, port = start_device(tmp_path / "device.yaml")
    scan = SCAN | {"frequency_hz": 1.0, "amplitude_deg": 4.0}
    block = BENCH["commission"] | {"minutes": 1.3, "motions": {"scan": scan}}
    transport = {"kind": "udp", "host": "127.0.0.1", "port": port}
    bench, out = written(tmp_path, transport=transport, commission=block), tmp_path / "run"
    trials = out / "2-record" / "trials"
    over = threading.Event()

    def interrupt() -> None:
        while not over.is_set():
            if len(list(trials.glob("*.csv"))) >= 2 and (out / "2-record" / "runs" / "slow_sine").exists():
                time.sleep(1.0)
                return signal.raise_signal(signal.SIGINT)
            time.sleep(0.05)
        return None

    waiting = threading.Thread(target=interrupt, daemon=True)
    try:
        waiting.start()
        code, _, said = run(capsys, "commission", bench, "--out", out)
        assert (code, "stopped: SIGINT" in said) == (3, True), said[-500:]
        kept = {f: f.read_bytes() for f in trials.glob("*.csv")}
        assert len(kept) >= 2
        assert run(capsys, "commission", bench, "--out", out)[0] == 2
        code, said, problem = run(capsys, "commission", bench, "--out", out, "--reset")
        assert code == 0, problem[-500:]
        assert "controller:" in said
        assert {f: f.read_bytes() for f in kept} == kept
        assert sorted(f.stem for f in trials.glob("*.csv")) == sorted(
            ["steps", "long_holds", "slow_sine", "shrinking_sine", "fast_sine", "reversals"]
        )
    finally:
        over.set()
        process.send_signal(signal.SIGINT)
        text, _ = process.communicate(timeout=30)
        end(process)
    assert "0 of them beyond the limits" in text
    assert json.loads((out / "device_time.json").read_text())["seconds"] < 90
    hystmpc.TipController.from_config(out / "tip.yaml").set_target(50.0)

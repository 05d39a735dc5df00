"""`hystmpc commission` as a user calls it: what is said beforehand, exit codes, and a device behind a real socket."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import hystmpc
from hystmpc.bench import device, motions, phases
from hystmpc.rig.recording.recording import RecordingMeta, open_recording
from hystmpc.rig.recording.sample import Sink
from hystmpc.trials.config import dump_yaml
from hystmpc_lab.faults.play import end, start_device

from ..cli.test_verbs import run
from ..rig.forked import forked
from .small_commission import BENCH, SCAN

__all__ = ["forked"]

PLAYED = ("shrinking_sine", "fast_sine")
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


@pytest.mark.usefixtures("quick")
def test_ctrl_c_in_a_computation_keeps_the_stages(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hystmpc.bench.commission.fit_model", interrupted)
    code, _, said = run(capsys, "commission", written(tmp_path), "--out", tmp_path / "run")
    assert code == 130
    assert "the same command goes on" in " ".join(said.split())
    assert (tmp_path / "run" / "3-check" / "result.json").exists()
    assert not (tmp_path / "run" / "4-fit" / "result.json").exists()


@pytest.fixture
def short(quick: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two short recordings; what is measured is written in a thread: no process is started for each motion."""
    whole = motions.identification_motions

    def some(*arguments: Any) -> Iterator[tuple[str, Any]]:
        return (named for named in whole(*arguments) if named[0] in PLAYED)

    def recorder(folder: Path, config: Any, meta: RecordingMeta, rate_hz: float, *views: object, report: bool) -> Sink:
        return open_recording(folder, config, meta, rate_hz, report=report)

    monkeypatch.setattr(device, "open_recorder_process", recorder)
    monkeypatch.setattr(phases, "HOLD_S", 0.2)
    monkeypatch.setattr(motions, "_REST_S", 0.3)
    monkeypatch.setattr(motions, "_RECORD_SHARE", 0.65)
    monkeypatch.setattr(motions, "_RECORDINGS", len(PLAYED))
    monkeypatch.setattr(motions, "identification_motions", some)


@pytest.fixture
def udp(forked: None, tmp_path: Path) -> Iterator[int]:
    """The port of a device process, which has counted no command beyond its limits when it ends."""
    (tmp_path / "device.yaml").write_text(dump_yaml(DEVICE))
    process, port = start_device(tmp_path / "device.yaml")
    yield port
    process.send_signal(signal.SIGINT)
    text, _ = process.communicate(timeout=30)
    end(process)
    assert "0 of them beyond the limits" in text


def interrupt_once(folder: Path) -> None:
    """Ctrl-C half a second after a folder has appeared."""

    def wait() -> None:
        while not folder.exists():
            time.sleep(0.05)
        time.sleep(0.5)
        signal.raise_signal(signal.SIGINT)

    threading.Thread(target=wait, daemon=True).start()


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_over_udp_ctrl_c_keeps_what_is_complete_and_the_same_command_goes_on(
    udp: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In real time, with two recordings; the device itself counts commands beyond its limits."""
    scan = SCAN | {"frequency_hz": 1.0, "start_deg": 51.0, "amplitude_deg": 4.0}
    block = BENCH["commission"] | {"minutes": 1.0, "range_steps": 4, "motions": {"scan": scan}}
    transport = {"kind": "udp", "host": "127.0.0.1", "port": udp}
    bench, out = written(tmp_path, transport=transport, commission=block), tmp_path / "run"
    trials = out / "2-record" / "trials"
    interrupt_once(out / "2-record" / "runs" / PLAYED[1])
    code, _, said = run(capsys, "commission", bench, "--out", out)
    assert (code, "stopped: SIGINT" in said) == (3, True), said[-500:]
    kept = {f: f.read_bytes() for f in trials.glob("*.csv")}
    assert [f.stem for f in kept] == [PLAYED[0]]
    assert run(capsys, "commission", bench, "--out", out)[0] == 2
    code, said, problem = run(capsys, "commission", bench, "--out", out, "--reset")
    assert code == 0, problem[-500:]
    assert "controller:" in said
    assert {f: f.read_bytes() for f in kept} == kept
    assert {f.stem for f in trials.glob("*.csv")} == set(PLAYED)
    assert json.loads((out / "device_time.json").read_text())["seconds"] < 75
    hystmpc.TipController.from_config(out / "tip.yaml").set_target(50.0)

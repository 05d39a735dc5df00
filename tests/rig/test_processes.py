"""A real device process, a real controller process, a real socket between them, and real signals."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from hystmpc.rig.recording.recorder_process import Views, open_recorder_process
from hystmpc.rig.recording.recording import RecordingMeta
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.recording import by_manifest
from hystmpc.trials.run_folder import RunFolder
from hystmpc_lab.faults.cases import CASES, Kind, Link, write_device, write_run
from hystmpc_lab.faults.forked import Forked
from hystmpc_lab.faults.judge import judge
from hystmpc_lab.faults.play import device_log, end, play, start_device

from ..cli.test_verbs import run as called
from .brief import brief
from .forked import forked
from .test_dds import needs_dds

__all__ = ["forked"]

PLAIN = CASES[0]


@pytest.fixture
def device(forked: None, tmp_path: Path) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """A device process; its port, and itself."""
    process, port = start_device(write_device(PLAIN, tmp_path))
    yield port, process
    end(process)


@pytest.mark.slow
def test_a_signal_ends_a_run_at_the_safe_command_and_latches(
    device: tuple[int, subprocess.Popen[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """SIGTERM of the controller, then the refusal, then the reset; SIGINT of the device ends it cleanly."""
    config = write_run(PLAIN, tmp_path, Link(port=device[0]))
    first = Forked(["run", config, "--out", tmp_path / "first"])
    until = time.monotonic() + 60
    while time.monotonic() < until and not any(row[3] > 1.0 for row in device_log(tmp_path)[-5:]):
        time.sleep(0.05)
    first.send_signal(signal.SIGTERM)
    said, _ = first.communicate(timeout=60)
    assert first.returncode == 3
    assert "stopped: SIGTERM" in said
    rows = device_log(tmp_path)
    assert rows[-1][3] == 0.0
    assert json.loads((tmp_path / "first" / "latched.json").read_text())["cause"] == "SIGTERM"
    assert "stop latched" in refusal(capsys, "run", config, "--out", tmp_path / "second")
    assert not (tmp_path / "second").exists()
    device[1].send_signal(signal.SIGINT)
    out, _ = device[1].communicate(timeout=30)
    assert device[1].returncode == 0
    assert "0 of them beyond the limits" in out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("sensor NaN", "udp"),
        ("model file corrupt", "udp"),
        ("all commands corrupted", "udp"),
        ("disk full", "udp"),
        ("controller paused 3 s at 4 mm", "udp"),
        ("terminal closed", "udp"),
        pytest.param("tip blocked", "dds", marks=needs_dds),
        pytest.param("the same, then the first one killed", "dds", marks=needs_dds),
    ],
)
@pytest.mark.usefixtures("forked")
def test_a_part_of_the_campaign(name: str, kind: Kind, tmp_path: Path) -> None:
    case = brief(name, cycles=1 if name == "disk full" else 3)
    if case.second is not None:  # it is refused once it has waited
        briefly = replace(case.second, arguments=(*case.second.arguments, "--set", "connect_timeout_s=1"))
        case = replace(case, second=briefly)
    if case.file_limit_bytes is not None:
        case = replace(case, file_limit_bytes=8_000)
    link = Link(kind, domain=10 + os.getpid() % 90)  # one that no other worker is in
    verdict = judge(case, play(case, tmp_path / "case", link))
    assert verdict.failures == (), verdict


SIMULATED = """
name: simulated
rate_hz: 25
command_unit: mm
limits: {lower: 0, upper: 6, rate_per_s: 10}
ramps: {velocity_per_s: 6, acceleration_per_s2: 60, jerk_per_s3: 1000}
safe_command: 0
latch_file: latched.json
sensor: {lower_deg: 0, upper_deg: 120}
transport: {kind: simulated, plant: {simulator: "builtin:tendon-catheter", noise_deg: 0.05}}
"""
RUN = """
controller: {model: "builtin:tendon-catheter"}
reference: {kind: point_to_point, start_deg: 35, targets_deg: [50], holds_s: [1]}
"""
RECORD = """
prepare: [{step: pretension_check, by: 1, hold_s: 0.2, least_move_deg: 3, most_move_deg: 20}]
excitations:
  steps: {kind: ramps, start: 0, stops: [2, 0], holds_s: [0.2, 0.2]}
  file: {kind: file, file: motion.csv}
settle_s: 0.1
"""


@pytest.mark.slow
def test_run_report_and_replay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A simulated run leaves a whole folder and advice; its report is made anew; its angles can be replayed."""
    (tmp_path / "run.yaml").write_text(SIMULATED + RUN)
    code, said, problem = called(capsys, "run", tmp_path / "run.yaml", "--out", tmp_path / "run")
    assert code == 0, problem
    assert "nothing is due" in said
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert {"config.yaml", "meta.json", "log.csv", "timing.json", "report.html", "trial.csv"} <= names
    assert not (tmp_path / "latched.json").exists()
    run = RunFolder.open(tmp_path / "run")
    log = run.log()
    assert "mpc" in log["source"]
    assert set(log["faults"]) == {"-"}
    assert float(log["command_mm"][-1]) == 0.0
    (tmp_path / "run" / "report.html").unlink()
    assert called(capsys, "report", tmp_path / "run")[0] == 0
    page = (tmp_path / "run" / "report.html").read_text()
    parts = ("Predicted and measured angle", "Timing", "Stages of a sample", "Sources and faults")
    assert [part for part in parts if part not in page] == []
    (tmp_path / "again.yaml").write_text(
        re.sub("transport: .*", "transport: {kind: replay, run: run}", SIMULATED) + RUN
    )
    code, _, problem = called(capsys, "run", tmp_path / "again.yaml", "--out", tmp_path / "again")
    assert code == 0, problem
    both = []
    for name in ("run", "again"):
        log = RunFolder.open(tmp_path / name).log()
        both.append([y for y, source in zip(log["angle_deg"], log["source"], strict=True) if source != "wait"])
    assert both[0][:40] == both[1][:40]


@pytest.mark.slow
def test_record_writes_trials_that_read_as_the_device_moved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "motion.csv").write_text("time_s,command_mm,separation_deg\n0,0,0\n1,2,0\n2,0,0\n")
    (tmp_path / "record.yaml").write_text(SIMULATED + RECORD)
    code, _, problem = called(capsys, "record", tmp_path / "record.yaml", "--out", tmp_path / "out")
    assert code == 0, problem
    trials = {path.stem: read_csv(path) for path in (tmp_path / "out" / "trials").glob("*.csv")}
    assert by_manifest([str(tmp_path / "out" / "trials" / f"{name}.csv") for name in trials]) is not None
    assert set(trials) == {"steps", "file"}
    assert trials["file"].command[25] == pytest.approx(2.0)
    assert trials["file"].dt == pytest.approx(0.04)
    moved = trials["file"].angle[25] - trials["file"].angle[0]
    assert 10 < moved < 25
    page = tmp_path / "out" / "report.html"
    assert "Recording at the bench" in page.read_text()
    page.unlink()
    assert called(capsys, "report", tmp_path / "out")[0] == 0
    assert "Recording at the bench" in page.read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("excitation", "expected"),
    [
        ("{kind: file, file: motion.csv}", "excitations.it: got commands in bar, expected the bench's mm"),
        ("{kind: s1_sinusoid, frequency_hz: 0.1}", "excitations.it: got commands in bar, expected the bench's mm"),
        ("{kind: file, file: nope.csv}", "nope.csv: no such file"),
    ],
)
def test_an_excitation_in_another_unit_is_refused(
    excitation: str, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "motion.csv").write_text("time_s,command_bar\n0,0\n1,1\n")
    (tmp_path / "record.yaml").write_text(SIMULATED + f"excitations: {{it: {excitation}}}\n")
    assert refusal(capsys, "record", tmp_path / "record.yaml", "--out", tmp_path / "out").endswith(expected)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_what_a_stranger_gets_wrong_is_one_line_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder that is taken, no device, a port that is taken; the folder is not even made."""
    config, out = tmp_path / "run.yaml", tmp_path / "out"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        udp = f"transport: {{kind: udp, port: {port}, bind_port: %d}}\nconnect_timeout_s: 0.2"
        config.write_text(re.sub("transport: .*", udp % port, SIMULATED) + RUN)
        assert "the controller cannot listen at 127.0.0.1" in refusal(capsys, "run", config, "--out", out)
        config.write_text(re.sub("transport: .*", udp % 0, SIMULATED) + RUN)
        assert f"got no angle from udp 127.0.0.1 port {port} within 0.2 s" in refusal(
            capsys, "run", config, "--out", out
        )
    assert "; nobody listens, " in refusal(capsys, "run", config, "--out", out)
    assert not out.exists()
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    assert "is not empty (notes.txt)" in refusal(capsys, "run", config, "--out", out)
    assert [path.name for path in out.iterdir()] == ["notes.txt"]
    assert not (tmp_path / "latched.json").exists()


@pytest.mark.slow
def test_a_page_or_a_latch_that_cannot_be_had_leaves_no_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, config = tmp_path / "out", tmp_path / "run.yaml"
    config.write_text(SIMULATED + RUN)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        meta, views = RecordingMeta("mm"), Views(page=True, port=taken.getsockname()[1])
        with pytest.raises(ConfigError, match="expected a free port"):
            open_recorder_process(out, {}, meta, 25.0, views)
        assert not out.exists()
    nowhere = ["--set", "latch_file=/proc/hystmpc/latched.json"]
    assert "expected a place to latch" in refusal(capsys, "run", config, "--out", out, *nowhere)
    (tmp_path / "latches").write_text("not a folder")
    latch = ["--set", f"latch_file={tmp_path}/latches/latched.json"]
    for more in ([], ["--reset"]):
        assert "expected a place to latch" in refusal(capsys, "run", config, "--out", out, *latch, *more)
    assert not out.exists()


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line that a call is refused with, exit code 2."""
    code, _, said = called(capsys, *arguments)
    assert code == 2
    (line,) = said.splitlines()
    assert line.startswith("error: ")
    return line


@pytest.mark.slow
def test_a_device_says_what_of_its_scheduling_is_refused_and_serves_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_device(PLAIN, tmp_path)
    code, said, refused = called(capsys, "device", config, "--seconds", "0.3", "--set", "realtime.cpu=10000")
    assert code == 0
    assert "device ready" in said
    (line,) = refused.splitlines()
    assert line.startswith("realtime.cpu: core 10000 refused")


@pytest.mark.slow
def test_an_excitation_beyond_the_limits_is_refused_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = SIMULATED.replace("rate_per_s: 10", "rate_per_s: 6.5") + RECORD
    (tmp_path / "motion.csv").write_text("time_s,command_mm\n0,0\n0.1,2\n2,0\n")
    (tmp_path / "record.yaml").write_text(text)
    assert "excitations.file" in refusal(capsys, "record", tmp_path / "record.yaml", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()

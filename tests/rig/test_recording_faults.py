"""Recording when things go wrong: a full disk, a killed process, files cut off anywhere."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.rig.recording.recorder_process import open_recorder_process
from hystmpc.rig.recording.recording import CsvLog, GrowingFile, McapLog, RecordingMeta, open_recording
from hystmpc.trials.check import check
from hystmpc.trials.errors import LogError
from hystmpc.trials.mcap_ import open_mcap
from hystmpc.trials.read import read_log
from hystmpc.trials.run_folder import RunFolder

from .recording_samples import sample

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
META = RecordingMeta("mm")


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """No file may grow beyond `size` bytes: the system takes what still fits, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def wait_for(condition) -> None:
    end = time.monotonic() + 20
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)


def test_on_a_full_disk_recording_ends_and_the_run_goes_on(tmp_path: Path) -> None:
    told: list[str] = []
    sink = open_recording(tmp_path / "run", {}, META, 100.0, told.append)
    for k in range(20):
        sink.put(sample(k))
    wait_for(lambda: sink.on_disk == 20)
    with full_disk((tmp_path / "run" / "log.csv").stat().st_size + 100):
        for k in range(20, 400):
            sink.put(sample(k))
        wait_for(lambda: sink.problem)
    for k in range(400, 500):
        sink.put(sample(k))
    sink.close()
    assert sum("recording has stopped" in text and "20 samples" in text for text in told) == 1
    assert sink.dropped == 480
    assert len(read_log(tmp_path / "run" / "log.csv")) == 20
    assert len(read_log(tmp_path / "run" / "log.mcap")) >= 20  # it still fitted in
    assert "recording has stopped" in (tmp_path / "run" / "report.html").read_text()


@given(commits=st.lists(st.binary(min_size=1, max_size=300), min_size=1, max_size=8), room=st.integers(1, 900))
@settings(max_examples=30)
def test_a_file_holds_whole_commits_only(
    commits: list[bytes], room: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("file") / "x"
    file, whole = GrowingFile(path), b""
    with full_disk(room):
        for data in commits:
            file.write(data)
            try:
                file.commit()
            except OSError:
                break
            whole += data
    file.close()
    assert path.read_bytes() == whole
    assert len(whole) == sum(map(len, commits)) or len(whole) <= room


@pytest.mark.slow
def test_when_the_recording_process_dies_the_run_goes_on(tmp_path: Path) -> None:
    told: list[str] = []
    sink = open_recorder_process(tmp_path / "run", {}, META, 100.0, tell=told.append)
    for k in range(30):
        sink.put(sample(k))
    wait_for(lambda: sink.on_disk == 30)
    os.kill(sink.pid, signal.SIGKILL)
    for k in range(30, 60):
        sink.put(sample(k))
        time.sleep(0.01)
    wait_for(lambda: sink.problem)
    sink.put(sample(60))
    sink.close()
    assert "has died; the run goes on without a log" in told[0]
    assert len(read_log(tmp_path / "run" / "log.csv")) == 30
    assert len(read_log(tmp_path / "run" / "log.mcap")) == 30


@pytest.mark.slow
def test_signals_to_all_of_a_terminal_cost_no_sample(tmp_path: Path) -> None:
    """Ctrl-C and a closed terminal reach the recording process too: it records the stop all the same."""
    sink = open_recorder_process(tmp_path / "run", {}, META, 100.0)
    for k, number in enumerate((signal.SIGINT, signal.SIGTERM, signal.SIGHUP)):
        sink.put(sample(k))
        os.kill(sink.pid, number)
        time.sleep(0.1)
    for k in range(3, 40):
        sink.put(sample(k))
    sink.close()
    assert sink.problem == ""
    assert len(read_log(tmp_path / "run" / "log.csv")) == 40


@pytest.mark.slow
def test_kill_minus_nine_costs_nothing_that_was_flushed() -> None:
    """The campaign of the benchmark in its smallest honest version: each way of dying once."""
    command = [sys.executable, "lab/benchmarks/kill_recording.py", "--kills", "3", "--longest", "1.5", "--seed", "5"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "controller killed" in done.stdout


@dataclass(frozen=True)
class Whole:
    """Logs of 40 samples, flushed after every 10th, and how long each file was then."""

    folder: Path
    lengths: dict[str, list[int]]

    def damaged(self, name: str, content: bytes | bytearray) -> Path:
        """The file with another content."""
        file = self.folder / "damaged" / name
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(content)
        return file


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    folder = tmp_path_factory.mktemp("whole")
    logs = {
        "log.csv": CsvLog(folder / "log.csv", "command_mm", ()),
        "log.mcap": McapLog(folder / "log.mcap", "command_mm"),
    }
    lengths: dict[str, list[int]] = {name: [] for name in logs}
    for k in range(40):
        for name, log in logs.items():
            log.add(sample(k, status='in 3, "tight" steps'))
            if k % 10 == 9:
                log.flush()
                lengths[name].append((folder / name).stat().st_size)
    for log in logs.values():
        log.close()
    return Whole(folder, lengths)


def prefix_or_refused(file: Path, reference: Path) -> int:
    """Samples read from a damaged file, all of them right; 0 where it is refused, in one line that names it."""
    refusal = ""
    try:
        trial = read_log(file)
    except LogError as error:
        refusal = str(error)
    if refusal:
        assert "\n" not in refusal
        assert file.name in refusal
        return 0
    expected = read_log(reference)
    for name in ("t", "command", "angle"):
        np.testing.assert_array_equal(getattr(trial, name), getattr(expected, name)[: len(trial)])
    return len(trial)


@settings(max_examples=70)
@given(data=st.data())
def test_a_table_cut_anywhere_gives_its_whole_rows(data: st.DataObject, whole: Whole) -> None:
    content = (whole.folder / "log.csv").read_bytes()
    cut = data.draw(st.integers(0, len(content)))
    file = whole.damaged("log.csv", content[:cut])
    # All numbers of a row are whole once the comma before its last cell is there, which is one character wide.
    rows = content[: cut + 2].count(b"\n") - 1
    assert prefix_or_refused(file, whole.folder / "log.csv") == (rows if rows >= 2 else 0)


@settings(max_examples=70)
@given(data=st.data())
def test_messages_cut_anywhere_give_all_that_was_flushed_before(data: st.DataObject, whole: Whole) -> None:
    content = (whole.folder / "log.mcap").read_bytes()
    cut = data.draw(st.integers(0, len(content)))
    file = whole.damaged("log.mcap", content[:cut])
    flushed = 10 * sum(length <= cut for length in whole.lengths["log.mcap"])
    assert prefix_or_refused(file, whole.folder / "log.csv") >= flushed


@settings(max_examples=30)
@given(data=st.data())
def test_a_flipped_byte_is_noticed_or_harmless(data: st.DataObject, whole: Whole) -> None:
    content = bytearray((whole.folder / "log.mcap").read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    prefix_or_refused(whole.damaged("log.mcap", content), whole.folder / "log.csv")


def test_a_log_that_is_cut_off_says_so(whole: Whole) -> None:
    content = (whole.folder / "log.mcap").read_bytes()
    log = open_mcap(whole.damaged("log.mcap", content[: whole.lengths["log.mcap"][1] + 7]))
    assert "cut off or damaged" in log.note
    findings = check(log.path).of("file")
    assert [finding.message for finding in findings] == [log.note]
    assert open_mcap(whole.folder / "log.mcap").note == ""


@given(texts=st.lists(st.tuples(st.text(), st.text(), st.lists(st.text(), max_size=2)), min_size=2, max_size=6))
@settings(max_examples=30)
def test_no_text_breaks_the_table(
    texts: list[tuple[str, str, list[str]]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    run = RunFolder.create(tmp_path_factory.mktemp("run"), {})
    log = CsvLog(run.path / "log.csv", "command_mm", ())
    for k, (source, status, faults) in enumerate(texts):
        log.add(sample(k, source=source, status=status, faults=tuple(faults)))
    log.flush()
    log.close()
    assert list(run.log()["sequence"]) == list(range(len(texts)))
    assert len(run.trial()) == len(texts)

"""kill -9 during logging: every run folder must be readable and hold all flushed samples; prints a table.

    python lab/benchmarks/kill_recording.py [--kills 100] [--seed 0] [--rate 250] [--longest 3]

A separate process records made-up samples at the given rate and reports the number on the disk after every flush. It
is killed at a random time, and the folder is compared with the report, sample by sample. Three kinds of kill
alternate: a recording by a thread, killed with its process; a recording by a process, all killed at once; and the
controller alone, whose recording process then ends its files by itself.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from kit import asked, show

from hystmpc.rig.recording.recorder_process import RecorderProcess, open_recorder_process
from hystmpc.rig.recording.recording import Recording, RecordingMeta, open_recording
from hystmpc.rig.recording.sample import Sample
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.mcap_ import MAGIC
from hystmpc.trials.read import read_log
from hystmpc.trials.run_folder import RunFolder

THREAD, PROCESS, CONTROLLER = "thread, process killed", "process, all killed", "process, controller killed"
WAYS = (THREAD, PROCESS, CONTROLLER)
_START_NS = 1_700_000_000_000_000_000
_PATIENCE_S = 30.0


@dataclass(frozen=True)
class Outcome:
    """Result of one kill: time, promised and recorded samples, and the fault (empty if there is none)."""

    way: str
    at_s: float
    promised: int
    in_csv: int
    in_mcap: int
    fault: str


def made_up(k: int, rate_hz: float) -> Sample:
    """Made-up sample number k, reproducible in every process."""
    t = k / rate_hz
    angle = 30 + 20 * math.sin(t)
    command = 3 + 2 * math.sin(1.3 * t)
    stages = (("estimate", 1e-4), ("plan", 5e-4), ("total", 7e-4))
    wall_ns = _START_NS + round(1e9 * t)
    text = f"solved, in {k % 7} steps"
    return Sample(t, wall_ns, angle, angle - 0.3, command, "mpc", text, angle, stages, 1 / rate_hz, 0.0, False, (), k)


def record(folder: Path, way: str, rate_hz: float) -> None:
    """Main function of the process that is killed: record and report the samples on the disk."""
    meta = RecordingMeta("mm", command_line=("kill_recording",))
    sink: Recording | RecorderProcess
    opening = open_recording if way == THREAD else open_recorder_process
    sink = opening(folder, {"rate_hz": rate_hz}, meta, rate_hz)
    said, start, k = -1, time.perf_counter(), 0
    while True:
        if sink.on_disk != said:
            said = sink.on_disk
            os.write(1, f"{said}\n".encode())
        sink.put(made_up(k, rate_hz))
        k += 1
        time.sleep(max(start + k / rate_hz - time.perf_counter(), 0.0))


def kill_once(folder: Path, way: str, rate_hz: float, at_s: float) -> Outcome:
    """Start a recording, kill it `at_s` after its start, and examine the folder."""
    said, child = _started(folder, way, rate_hz)
    with os.fdopen(said) as lines:
        try:
            promised = int(lines.readline())  # the first line marks the start
            time.sleep(at_s)
        finally:
            if way == CONTROLLER:
                os.kill(child, signal.SIGKILL)
            else:
                os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
        for line in lines:
            promised = int(line)
    if way == CONTROLLER:
        _await_end(folder / "log.mcap")
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    return _judged(folder, way, rate_hz, at_s, promised)


def _started(folder: Path, way: str, rate_hz: float) -> tuple[int, int]:
    """Start the recording process by a fork, which avoids its imports; return a pipe and its process id."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child:
        os.close(theirs)
        return ours, child
    try:
        os.setsid()
        os.dup2(theirs, 1)
        record(folder, way, rate_hz)
    finally:
        os._exit(1)


def _await_end(file: Path) -> None:
    """Wait until the recording process, which outlives its controller, has ended its MCAP file."""
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        content = file.read_bytes() if file.exists() else b""
        if len(content) > len(MAGIC) and content.endswith(MAGIC):
            return
        time.sleep(0.05)


def _judged(folder: Path, way: str, rate_hz: float, at_s: float, promised: int) -> Outcome:
    faults, counts = [], []
    try:
        if RunFolder.open(folder).config() != {"rate_hz": rate_hz}:
            faults.append("config.yaml differs")
    except HystmpcError as error:
        faults.append(str(error))
    for name in ("log.csv", "log.mcap"):
        count, fault = _samples(folder / name, rate_hz)
        counts.append(count)
        if count < promised:
            faults.append(f"{name}: {count} samples, {promised} were on the disk ({fault})")
        elif fault and promised:
            faults.append(f"{name}: {fault}")
    if way == CONTROLLER and not (folder / "log.mcap").read_bytes().endswith(MAGIC):
        faults.append("the recording process did not end its file")
    return Outcome(way, at_s, promised, counts[0], counts[1], "; ".join(faults))


def _samples(file: Path, rate_hz: float) -> tuple[int, str]:
    """Number of samples in a log, and its fault."""
    try:
        trial = read_log(file)
    except HystmpcError as error:
        return 0, str(error)
    expected = [made_up(k, rate_hz) for k in range(len(trial))]
    for name, values in (("t_s", trial.t), ("command", trial.command), ("measured_deg", trial.angle)):
        if not np.array_equal(values, [getattr(sample, name) for sample in expected]):
            return len(trial), f"{name} differs"
    return len(trial), ""


_COLUMNS = ("recording by", "kills", "unreadable or lost", "nothing flushed yet", "killed at [s]", "samples found")


def summary(outcomes: list[Outcome]) -> Iterator[tuple[object, ...]]:
    """Rows of the table, one for each kind of kill."""
    for way in WAYS:
        here = [outcome for outcome in outcomes if outcome.way == way]
        if here:
            times, found = [o.at_s for o in here], [min(o.in_csv, o.in_mcap) for o in here]
            lost, early = sum(bool(o.fault) for o in here), sum(not o.promised for o in here)
            ends = f"{min(times):.2f} to {max(times):.2f}", f"{min(found)} to {max(found)}"
            yield way, len(here), lost, early, *ends


def campaign(kills: int, seed: int, rate_hz: float, longest_s: float, folder: Path) -> list[Outcome]:
    """Kill the given number of recordings at random times, alternating between the three kinds."""
    times = np.random.default_rng(seed).uniform(0, longest_s, kills)
    return [kill_once(folder / str(k), WAYS[k % 3], rate_hz, float(at_s)) for k, at_s in enumerate(times)]


def main() -> int:
    """Run the campaign; exit code 1 if a folder was unreadable or a flushed sample is lost."""
    options = asked(__doc__, kills=100, seed=0, rate=(250.0, "samples per second"), longest=(3.0, "latest kill [s]"))
    with tempfile.TemporaryDirectory() as folder:
        outcomes = campaign(options.kills, options.seed, options.rate, options.longest, Path(folder))
    title = f"kill -9 while recording at {options.rate:g} Hz, flush every 0.5 s"
    show(_COLUMNS, summary(outcomes), title, width=112)
    for outcome in outcomes:
        if outcome.fault:
            print(f"{outcome.way}, killed at {outcome.at_s:.3f} s: {outcome.fault}")
    return int(any(outcome.fault for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())

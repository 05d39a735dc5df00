"""Recording: what is put in comes back from every file, from a thread as from a process of its own."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.rig.recording.recorder_process import RecorderProcess, open_recorder_process
from hystmpc.rig.recording.recording import Recording, RecordingMeta, open_recording
from hystmpc.rig.recording.sample import Sample, SampleQueue, Tee
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.read import read_log
from hystmpc.trials.run_folder import RunFolder

from .recording_samples import START_NS, sample

pytestmark = pytest.mark.slow

pytest.importorskip("mcap", reason="mcap (extra `logs`) is not installed")

META = RecordingMeta("mm", seed=3, command_line=("hystmpc", "run"))
CONFIG = {"rate_hz": 100.0}
N = 230


def events(k: int) -> Sample:
    """A run with a fault, a fallback and a missed deadline."""
    if 100 <= k < 110:
        return sample(k, measured_deg=float("nan"), source="hold", status="no angle", faults=("frozen", "stale"))
    return sample(k, missed=k == 150, status="late, by\n2 ms" if k == 150 else "solved")


@pytest.mark.parametrize("opening", [open_recording, open_recorder_process])
def test_every_sample_comes_back_from_every_file(opening: Any, tmp_path: Path) -> None:
    sink: Recording | RecorderProcess = opening(tmp_path / "run", CONFIG, META, 100.0)
    for k in range(N):
        sink.put(events(k))
    sink.close()
    assert (sink.dropped, sink.on_disk, sink.problem) == (0, N, "")

    run = RunFolder.open(tmp_path / "run")
    assert run.config() == CONFIG
    assert (run.meta["seed"], run.meta["command_line"]) == (3, ["hystmpc", "run"])
    assert "<svg" in (run.path / "report.html").read_text()
    log = run.log()
    expected = [events(k) for k in range(N)]
    for column, field in COLUMNS.items():
        np.testing.assert_array_equal(log[column], [getattr(s, field) for s in expected])
    np.testing.assert_array_equal(log["stage_plan_s"], [5e-4] * N)
    assert (log["source"][105], log["faults"][105], log["faults"][5]) == ("hold", "frozen stale", "-")
    assert log["status"][150] == "late, by 2 ms"


COLUMNS = {
    "time_s": "t_s",
    "command_mm": "command",
    "angle_deg": "measured_deg",
    "angle_taken_s": "taken_s",
    "reference_deg": "reference_deg",
    "predicted_deg": "predicted_deg",
    "period_s": "period_s",
    "lateness_s": "lateness_s",
    "sequence": "sequence",
    "missed": "missed",
}


def test_both_logs_of_a_run_are_the_same_trial(tmp_path: Path) -> None:
    sink = open_recording(tmp_path / "run", CONFIG, RecordingMeta("bar"), 100.0, report=False)
    for k in range(N):
        sink.put(sample(k))
    sink.close()
    table, messages = read_log(tmp_path / "run" / "log.csv"), read_log(tmp_path / "run" / "log.mcap")
    for name in ("t", "command", "angle"):
        np.testing.assert_array_equal(getattr(table, name), getattr(messages, name))
    np.testing.assert_array_equal(table.channels["reference_deg"], messages.channels["reference_deg"])
    assert table.units == messages.units
    assert table.units.command == "bar"


def test_the_mcap_log_is_what_viewers_expect(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    sink = open_recording(tmp_path / "run", CONFIG, META, 100.0, report=False)
    for k in range(N):
        # The wall clock jumps back by an hour; the plot must not.
        sink.put(events(k) if k < 120 else sample(k, wall_ns=START_NS - 3_600_000_000_000))
    sink.close()
    with (tmp_path / "run" / "log.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        found = list(reader.iter_messages())
    assert summary is not None
    assert {c.topic: summary.schemas[c.schema_id].encoding for c in summary.channels.values()} == {
        "/tip": "jsonschema",
        "/timing": "jsonschema",
        "/events": "jsonschema",
    }
    tips = [(m, json.loads(m.data)) for _, channel, m in found if channel.topic == "/tip"]
    assert [m.log_time for m, _ in tips] == [START_NS + 10_000_000 * k for k in range(N)]
    assert tips[105][1]["angle_deg"] is None
    levels = [json.loads(m.data)["level"] for _, channel, m in found if channel.topic == "/events"]
    assert levels == [2, 3, 2]  # begins, loses the angle, has it again


def test_a_run_folder_is_never_overwritten(tmp_path: Path) -> None:
    open_recording(tmp_path / "run", CONFIG, META, 100.0).close()
    for opening in (open_recording, open_recorder_process):
        with pytest.raises(ConfigError, match="expected a new or empty folder"):
            opening(tmp_path / "run", CONFIG, META, 100.0)


def test_settings_are_checked_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="'furlong', expected mm, bar"):
        RecordingMeta("furlong")
    with pytest.raises(ConfigError, match=r"rate of -1\.0 Hz"):
        open_recording(tmp_path / "run", CONFIG, META, -1.0)


def test_an_empty_run_ends_without_a_word(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        sink = open_recording(tmp_path / "run", CONFIG, META, 100.0, report=False)
        sink.close()
        sink.close()
    assert (sink.dropped, caplog.text) == (0, "")


ANYTHING = st.one_of(
    st.none(),
    st.floats(),
    st.integers(),
    st.text(),
    st.tuples(st.text(), st.floats()),
    st.builds(object),
    st.builds(sample, st.integers(0, 10**6), status=st.text(), source=st.text(), faults=st.tuples(st.text())),
    st.builds(sample, st.integers(), t_s=st.floats(), command=st.floats(), stages_s=st.none(), wall_ns=st.integers()),
    st.builds(sample, st.just(0), lateness_s=st.text(), sequence=st.none(), missed=st.none()),
)


@settings(max_examples=25)
@given(rubbish=st.lists(ANYTHING, max_size=12))
def test_put_takes_anything_and_what_is_right_is_recorded(
    rubbish: list[Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """put never raises, and a thread that meets what is no sample goes on with the next one."""
    folder = tmp_path_factory.mktemp("run")
    told: list[str] = []
    sink = open_recording(folder, CONFIG, META, 100.0, told.append, report=False)
    sink.put(sample(0))
    for thing in rubbish:
        sink.put(thing)
    sink.put(sample(1))
    sink.close()
    assert sink.problem == ""
    assert sink.on_disk + sink.dropped == len(rubbish) + 2
    sequence = RunFolder.open(folder).log()["sequence"]
    assert len(sequence) == sink.on_disk
    assert (float(sequence[0]), float(sequence[-1])) == (0, 1)
    sink.put(sample(2))  # after the end: counted, not raised
    assert sink.on_disk + sink.dropped == len(rubbish) + 3


@given(most=st.integers(1, 20), puts=st.integers(0, 60), takes=st.sets(st.integers(0, 60)))
def test_a_full_queue_counts_what_it_refuses_and_keeps_the_order(most: int, puts: int, takes: set[int]) -> None:
    waiting, taken = SampleQueue(most), []
    for k in range(puts):
        waiting.put(sample(k))
        assert len(waiting) <= most
        if k in takes:
            taken += waiting.take()
    taken += waiting.take()
    assert len(taken) + waiting.dropped == puts
    numbers = [s.sequence for s in taken]
    assert numbers == sorted(numbers)
    assert numbers[: min(most, puts)] == list(range(min(most, puts)))


class Breaks:
    """A sink that breaks its promise."""

    def put(self, sample: Sample) -> None:
        del sample
        raise RuntimeError("put")

    def close(self) -> None:
        raise RuntimeError("close")


def test_a_fan_serves_the_others_where_one_breaks(tmp_path: Path) -> None:
    sink = open_recording(tmp_path / "run", CONFIG, META, 100.0, report=False)
    fan = Tee(sink, Breaks())
    for k in range(5):
        fan.put(sample(k))
    assert fan.broken == 5
    with pytest.raises(RuntimeError, match="close"):
        fan.close()
    assert sink.on_disk == 5

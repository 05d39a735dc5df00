"""Recordings of two axes, their report, and the live views of a run of two axes."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from hystmpc.bench.device import plants_in
from hystmpc.rig.axes import together
from hystmpc.rig.experiment.record import PlaneRecordSettings, load_record, record
from hystmpc.rig.live.page import message
from hystmpc.rig.live.state import LiveState
from hystmpc.rig.live.terminal import TerminalView, headline
from hystmpc.rig.recording.recording import RecordingMeta, open_recording
from hystmpc.rig.recording.report import write_report
from hystmpc.rig.recording.sample import SampleList
from hystmpc.tasks.evaluate import evaluate
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.run_folder import RunFolder

from .plane_bench import LIMITS, RATE_HZ, model_in
from .recording_samples import sample

RAMPS = {"kind": "ramps", "start": [0, 0.5], "stops": [[1.5, -1.0], [-1.0, 0.5]], "holds_s": [0.1, 0.1]}


def settings_of(folder: Path, **changes: Any) -> PlaneRecordSettings:
    """A recording on a simulated device, read from its file as the command line does."""
    model_in(folder)
    plain = {
        "name": "two-planes", "rate_hz": RATE_HZ, "command_unit": "mm", "limits": LIMITS, "safe_command": [0.0, 0.5],
        "ramps": {"velocity_per_s": 4.0, "acceleration_per_s2": 40.0, "jerk_per_s3": 800.0}, "settle_s": 0.1,
        "sensor": {"lower_deg": -60, "upper_deg": 60}, "latch_file": "latch.json", "excitations": {"both": RAMPS},
        "transport": {"kind": "simulated", "plant": {"simulator": "both.yaml", "noise_deg": 0.02}},
    }  # fmt: skip
    file = folder / "record.yaml"
    file.write_text(dump_yaml(plain | changes), encoding="utf-8")
    made = load_record(file)
    assert isinstance(made, PlaneRecordSettings)
    return made


def test_a_recording_of_two_axes_is_a_trial_on_which_its_model_errs_by_the_noise_alone(tmp_path: Path) -> None:
    wanted, folder = settings_of(tmp_path), tmp_path / "run"
    meta = RecordingMeta("mm", axes=2)
    result = record(
        wanted, lambda: open_recording(folder, wanted, meta, RATE_HZ, report=False), plants_in(tmp_path, "mm"), folder
    )
    assert result.bench.outcome.cause == ""
    assert [trial.name for trial in result.trials] == ["both.csv"]
    header = result.trials[0].read_text(encoding="utf-8").splitlines()[0]
    assert header == "time_s,command_x,command_y,angle_x_deg,angle_y_deg"
    errors = evaluate(tmp_path / "both.yaml", result.trials)
    assert errors.mean.rmse_deg < 0.3
    page = write_report(RunFolder.open(folder)).read_text(encoding="utf-8")
    assert "Axis x over time." in page
    assert "Axis y over time." in page


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,command_x\n0,0\n1,1\n", "command_y"),
        ("time_s,command_x,command_y\n0,0,0\n0,1,1\n", "increasing time_s"),
        ("time_s,command_x,command_y\n0,0,0\n0.01,1,1\n", "at up to"),
    ],
)
def test_a_file_that_does_not_move_both_axes_within_limits_is_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "motion.csv").write_text(text, encoding="utf-8")
    wanted = settings_of(tmp_path, excitations={"drawn": {"kind": "file", "file": "motion.csv"}})
    with pytest.raises((ConfigError, LogError)) as error:
        record(wanted, SampleList, plants_in(tmp_path, "mm"), tmp_path / "run")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_of_both_commands_is_sampled_at_the_rate_of_the_bench(tmp_path: Path) -> None:
    rows = "time_s,command_x,command_y\n0,0,0.5\n1,1,-0.5\n"
    (tmp_path / "motion.csv").write_text(rows, encoding="utf-8")
    wanted = settings_of(tmp_path, excitations={"drawn": {"kind": "file", "file": "motion.csv"}})
    commands = wanted.excitations["drawn"].commands(RATE_HZ, wanted.ramps)
    assert commands.shape == (RATE_HZ + 1, 2)
    assert commands[25] == pytest.approx((0.5, 0.0))


def pair(k: int, **changes: Any) -> Any:
    """Sample k whose tip is 5 deg off: 3 in x, 4 in y."""
    return sample(
        k,
        RATE_HZ,
        command=together((1.0, -2.0)),
        reference_deg=together((10.0, 20.0)),
        measured_deg=together((7.0, 16.0)),
        **changes,
    )


def test_the_error_that_is_shown_is_the_distance_in_the_plane() -> None:
    state = LiveState(RATE_HZ)
    state.update(pair(k) for k in range(200))
    assert state.rms_deg == pytest.approx(5.0)
    assert state.angle.shape == state.command.shape == (len(state.t), 2)
    assert "error   5.00 (rms 5.00)" in headline(state, "mm").plain
    assert "(1.000, -2.000) mm" in headline(state, "mm").plain


def test_the_page_gets_a_curve_of_each_axis() -> None:
    state = LiveState(RATE_HZ)
    state.update([pair(0), pair(1, source="wait"), pair(2, predicted_deg=math.nan)])
    shown = json.loads(json.dumps(message(state, "mm", RATE_HZ), allow_nan=False))
    assert shown["angle_deg"] == [7.0, 16.0]
    assert set(shown["curves"]) == {"t", *(f"{n}_{a}" for n in ("reference", "angle", "command") for a in "xy")}
    assert shown["curves"]["command_y"] == [-2.0] * len(shown["curves"]["t"])


def test_a_missing_angle_of_one_axis_is_a_gap_of_its_curve_alone() -> None:
    state = LiveState(RATE_HZ)
    state.update([pair(0), sample(1, RATE_HZ, command=together((1.0, 2.0)), measured_deg=together((math.nan, 16.0)))])
    assert np.isnan(state.angle[-1]).tolist() == [True, False]
    assert "no angle" in headline(state, "mm").plain


def test_the_terminal_draws_both_axes() -> None:
    console = Console(file=io.StringIO(), width=100, force_terminal=True)
    view = TerminalView("mm", RATE_HZ, console=console)
    try:
        state = LiveState(RATE_HZ)
        state.update(pair(k) for k in range(50))
        with console.capture() as shown:
            console.print(view.render(state))
    finally:
        view.close()
    text = shown.get()
    assert "command x" in text
    assert "command y" in text

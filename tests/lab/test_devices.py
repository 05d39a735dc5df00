"""Kinds over devices: a device counts the same in every unit, the best kind of a device has the ratio one."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hystmpc.cli.main import app
from hystmpc.models.chain import Chain
from hystmpc.models.evaluate import evaluate
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.trial import Trial, Units
from hystmpc_lab.papers.job import study_splits
from hystmpc_lab.papers.real import device_settings, real_tasks

from ..gap.engine_examples import moves, simulator_of, trials_of
from ..models.zoo import BACKLASH

LIST = """
catheter:
  logs: [mm_0.csv, mm_1.csv]
piston:
  logs: [whole.csv]
  parts: 2
"""


def listed(folder: Path) -> Path:
    """A list of two devices that differ in their units, each logged in two trials; the second ones in one log."""
    trials = trials_of(Chain(BACKLASH), [moves(1, 12.0), moves(2, 12.0)])
    for k, trial in enumerate(trials):
        write_csv(trial, folder / f"mm_{k}.csv")
    first, second = trials
    u, y = (np.concatenate(signals) for signals in ((first.command, second.command), (first.angle, second.angle)))
    units = Units("V", "N", inverse=False)
    write_csv(Trial(0.04 * np.arange(u.size, dtype=np.float64), 25.4 * u, 1e-3 * y, units=units), folder / "whole.csv")
    file = folder / "devices.yaml"
    file.write_text(LIST, encoding="utf-8")
    return file


@pytest.mark.slow
def test_one_command_ranks_kinds_over_devices(tmp_path: Path) -> None:
    out = tmp_path / "out"
    told = ["study", "kinds", "--data", str(listed(tmp_path)), "--kinds", "backlash,maxwell_slip"]
    result = CliRunner().invoke(app, [*told, "--out", str(out), "--jobs", "1", "--quick"])
    assert result.exit_code == 0, result.output
    with (out / "tables" / "kinds_errors.csv").open(encoding="utf-8") as file:
        rows = {row["kind"]: row for row in csv.DictReader(file)}
    assert next(iter(rows)) == "backlash"  # what the devices are
    assert float(rows["backlash"]["over the best, worst"]) == pytest.approx(1.0)
    assert float(rows["backlash"]["catheter"]) == pytest.approx(float(rows["backlash"]["piston"]), rel=0.2)
    assert "Try backlash first" in (out / "report.html").read_text(encoding="utf-8")
    with (out / "tables" / "kinds_cost.csv").open(encoding="utf-8") as file:
        assert {row["kind"]: row["numbers"] for row in csv.DictReader(file)}["backlash"] == "4"


def test_a_list_of_devices_is_read_beside_its_logs(tmp_path: Path) -> None:
    found = device_settings(listed(tmp_path), kinds=("pi",))
    assert {name: (s.parts, s.kinds, s.logs[0]) for name, s in found.items()} == {
        "catheter": (1, ("pi",), str(tmp_path / "mm_0.csv")),
        "piston": (2, ("pi",), str(tmp_path / "whole.csv")),
    }
    (tmp_path / "wrong.yaml").write_text("catheter: {log: a.csv}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="catheter"):
        device_settings(tmp_path / "wrong.yaml")


def test_a_part_of_a_log_is_scored_as_that_stretch_of_a_free_run_over_the_log(tmp_path: Path) -> None:
    """A slow device is in motion where a part begins: its state is known from what was recorded before."""
    slow = Chain(BACKLASH, (Lag(3.0),))
    log = trials_of(slow, [moves(1, 24.0)])[0]
    write_csv(log, tmp_path / "whole.csv")
    (tmp_path / "one.yaml").write_text("device: {logs: [whole.csv], parts: 3}\n", encoding="utf-8")
    settings = device_settings(tmp_path / "one.yaml", kinds=("backlash",))["device"]
    tasks = real_tasks(settings, study_splits(settings))
    assert [0 if task.before is None else len(task.before) for task in tasks] == [0, 200, 400]
    assert len({str(task.inputs) for task in tasks}) == 3

    model = ChainModel(replace(simulator_of(BACKLASH), chain=slow))
    whole = evaluate(model, log).theta
    parts = [task.tests["logs"][0] for task in tasks]
    theta = [evaluate(model, part, before=task.before).theta for part, task in zip(parts, tasks, strict=True)]
    np.testing.assert_allclose(np.concatenate(theta), whole, atol=1e-5)  # the file has six digits
    alone, behind = evaluate(model, parts[1]), evaluate(model, parts[1], before=tasks[1].before)
    assert alone.unscored_s > 0 == behind.unscored_s  # alone it tells its state by its first seconds
    assert behind.errors.max_abs_error_deg < 0.3

"""Diagnosis stage of two axes, and a commissioning from logs: what `hystmpc diagnose` names, and what is used of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import hystmpc
from hystmpc.bench import identify
from hystmpc.bench import plane as both
from hystmpc.bench.commission import NAMES, commission_logs, rewrite_report
from hystmpc.bench.identify import FittedModel, Subject
from hystmpc.bench.stages import write_recording
from hystmpc.ctrl.command import CommandLimits
from hystmpc.gap.two_axes.diagnosis import TwoAxisDiagnosis
from hystmpc.gap.two_axes.words import headlines
from hystmpc.models.contract.metadata import Range
from hystmpc.models.two_axes.model import TwoAxisModel, load_two_axes
from hystmpc.rig.axes import each
from hystmpc.sim.tuning import gains
from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.json_text import file_text, plain
from hystmpc.trials.trial import Trial

from ..models.two_axis_examples import DT, axis, recorded, two_axes
from .small_plane import plane_settings, turned

GIVEN = two_axes()
DEVICE = replace(GIVEN, axes=(GIVEN.axes[0], axis(10.0, 0.25)), mix=turned(8.0).mix)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The model is given, as one that was identified before the device changed; the search of gains is short."""

    def fitted(subject: Subject, folder: Path, progress: object) -> FittedModel:
        limits: tuple[CommandLimits, ...] = each(subject.limits)
        ends, rates = [Range(lower=one.lower, upper=one.upper) for one in limits], [one.rate for one in limits]
        model = replace(GIVEN, command_limits=tuple(ends), command_rates_per_s=tuple(rates))
        model.save(folder / identify.MODEL_FILE)
        return FittedModel("given", (), (), 0.07, 0.1, ())

    monkeypatch.setattr("hystmpc.bench.commission.fit_both", fitted)
    monkeypatch.setattr(identify, "_TUNED_S", 1.0)
    monkeypatch.setattr(gains, "_PER_PARAMETER", 1)
    monkeypatch.setattr(both, "evaluations", lambda subject: {"pid": 4, "inverse_pid": 4})


def logs_of(device: TwoAxisModel, folder: Path, seeds: range = range(2)) -> list[Path]:
    """Recordings of a device, in files."""
    trials = recorded(device, seeds)
    return [write_recording(trial, folder / "logs" / f"log_{k}.csv") for k, trial in enumerate(trials)]


def stage(out: Path) -> dict[str, Any]:
    """Result of the diagnosis stage."""
    return dict(json.loads((out / NAMES[4] / "result.json").read_text())["result"])


@pytest.mark.slow
def test_the_stage_names_what_diagnose_names_on_the_same_recordings(tmp_path: Path) -> None:
    """The controller gets what is certified of it, and nothing else."""
    files, out = logs_of(DEVICE, tmp_path), tmp_path / "out"
    made = commission_logs(files, out)
    alone = cast(TwoAxisDiagnosis, hystmpc.diagnose(files, out / NAMES[3] / "model.yaml", ordered=True))
    assert [effect.name for effect in alone.joins.effects] == ["misalignment"]
    assert (alone.x.verdict, [effect.name for effect in alone.y.effects]) == ("none", ["lag"])
    written = json.loads((out / NAMES[4] / "diagnosis" / "diagnosis.json").read_text())
    assert written == json.loads(file_text(plain(alone.as_json())))
    assert [line.rstrip(".").casefold() for line in stage(out)["verdict"][:3]] == [
        line.casefold() for line in headlines(alone)
    ]
    assert (stage(out)["corrected"], made.model.name) == (True, "model.fixed.yaml")
    assert (out / read_yaml(out / "tip.yaml")["model"]).resolve() == made.model.resolve()
    used = load_two_axes(made.model)
    np.testing.assert_allclose(used.matrix, DEVICE.matrix, atol=0.02)
    assert used.axes[0].chain == GIVEN.axes[0].chain
    assert len(used.axes[1].chain.before) + len(used.axes[1].chain.after) > 1
    assert "Axis y: " in made.report.read_text(encoding="utf-8")


def test_logs_alone_end_before_the_verification(tmp_path: Path) -> None:
    """As of one axis: no stage of the device, a controller within the limits, the same report once more."""
    files, out, bench = logs_of(GIVEN, tmp_path), tmp_path / "out", plane_settings(tmp_path)
    found = commission_logs(files, out, bench)
    assert found.verified is None
    assert [name for name in NAMES if (out / name).exists()] == [NAMES[2], NAMES[3], NAMES[5]]
    assert "nothing was verified" in found.report.read_text(encoding="utf-8")
    limits = read_yaml(out / "tip.yaml")["limits"]
    commands = np.vstack([trial.commands for trial in recorded(GIVEN, range(2))])
    np.testing.assert_allclose([limits["lower"], limits["upper"]], [commands.min(axis=0), commands.max(axis=0)])
    tip, last = hystmpc.TipController.from_config(found.tip), np.zeros(2)
    tip.set_target((12.0, -9.0))
    for _ in range(20):
        u = np.asarray(tip.step((0.0, 0.0)).u)
        assert np.all(np.abs(u - last) <= np.array(limits["rate_per_s"]) * DT + 1e-9)
        last = u
    before = found.model.read_bytes()
    assert commission_logs(files, out, bench).model.read_bytes() == before
    found.report.unlink()
    assert rewrite_report(out).report.exists()
    files[0].write_text("".join(files[0].read_text().splitlines(keepends=True)[:-1]))
    with pytest.raises(LogError, match="expected the recordings that it was made from"):
        rewrite_report(out)


def test_ctrl_c_in_the_diagnosis_keeps_the_stages_before_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files, out = logs_of(GIVEN, tmp_path), tmp_path / "out"

    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(both, "diagnose_two_axes", interrupted)
    with pytest.raises(KeyboardInterrupt):
        commission_logs(files, out)
    assert (out / NAMES[3] / "result.json").exists()
    assert not (out / NAMES[4] / "result.json").exists()


def test_logs_that_do_not_fit_the_bench_are_one_line(tmp_path: Path) -> None:
    (file,), bench = logs_of(GIVEN, tmp_path, range(1)), plane_settings(tmp_path)
    header, *rows = file.read_text().splitlines()
    names = [name for name in header.split(",") if "_y" not in name]
    kept = [header.split(",").index(name) for name in names]
    one = tmp_path / "one.csv"
    said = ",".join("command" if "command" in n else "angle_deg" if "angle" in n else n for n in names)
    one.write_text("\n".join([said, *(",".join(row.split(",")[k] for k in kept) for row in rows)]) + "\n")
    still = tmp_path / "still.csv"
    trial = recorded(GIVEN, range(1))[0]
    write_recording(Trial(trial.t, trial.commands * [1.0, 0.0], trial.angles, source="still"), still)
    beyond = plane_settings(
        tmp_path, limits={"lower": [5, 5], "upper": [8, 8], "rate_per_s": [8, 6]}, safe_command=[5, 5]
    )
    for logs, settings, expected in (
        ([one], bench, "logs: got one axis, expected two axes as in the bench file"),
        ([still], None, "logs: the command y does not move"),
        ([file], beyond, "commands are beyond the bench's limits"),
    ):
        with pytest.raises((ConfigError, LogError), match=expected) as refused:
            commission_logs(logs, tmp_path / "out", settings)
        assert len(str(refused.value)) <= 300
        assert "\n" not in str(refused.value)
        assert not (tmp_path / "out").exists()

"""Diagnosis of two axes: what joins them is named for what it is, an axis for what it lacks, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

import hystmpc
from hystmpc.gap.two_axes.diagnosis import TWO_AXIS_FORMAT, TwoAxisDiagnosis
from hystmpc.gap.two_axes.joins import JoinTrials, find_joins
from hystmpc.gap.two_axes.words import headlines
from hystmpc.models.two_axes.model import TwoAxisModel, load_two_axes
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.trial import Trial

from ..models.two_axis_examples import SHARED, Row, axis, recorded, two_axes

GIVEN = two_axes()
COS, SIN = (float(f(np.deg2rad(8.0))) for f in (np.cos, np.sin))
TURNED: tuple[Row, Row] = ((COS, -SIN), (SIN, COS))
FRAME: tuple[Row, Row] = ((1.0, 0.15), (-0.1, 1.0))
SEEDS = range(3)
LAGGED = replace(GIVEN, axes=(GIVEN.axes[0], axis(10.0, 0.25)))


def diagnosed(device: TwoAxisModel, out: Path | None = None) -> TwoAxisDiagnosis:
    return cast(TwoAxisDiagnosis, hystmpc.diagnose(recorded(device, SEEDS), GIVEN, out))


def test_a_device_equal_to_its_model_says_none() -> None:
    diagnosis = diagnosed(GIVEN)
    assert (diagnosis.joins.effects, diagnosis.x.verdict, diagnosis.y.verdict) == ((), "none", "none")
    assert not diagnosis.named
    assert [line.partition(":")[0] for line in headlines(diagnosis)] == ["between the axes", "axis x", "axis y"]


def test_turned_tendons_are_misalignment_and_nothing_else(tmp_path: Path) -> None:
    diagnosis = diagnosed(two_axes(TURNED), tmp_path / "out")
    (effect,) = diagnosis.joins.effects
    assert effect.name == "misalignment"
    for name, truth in (("turn_deg", 8.0), ("skew_deg", 0.0)):
        low, high = effect.ci90[name]
        assert abs(effect.parameters[name] - truth) < high - low < 1.0  # one draw: twice the half of a 90 % interval
    assert effect.closed_share > 0.9
    assert (diagnosis.joins.ambiguity, diagnosis.x.verdict, diagnosis.y.verdict) == ((), "none", "none")
    written = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert (written["format"], written["x"]["verdict"]) == (TWO_AXIS_FORMAT, "none")
    assert written["joins"]["effects"][0]["units"] == {"turn_deg": "deg", "skew_deg": "deg"}
    np.testing.assert_allclose(load_two_axes(tmp_path / "out" / "sim.fixed.yaml").matrix, TURNED, atol=0.01)
    assert "Misalignment explains" in (tmp_path / "out" / "report.html").read_text()
    assert (tmp_path / "out" / "y" / "report.html").is_file()


def test_a_lag_of_one_axis_is_named_there_alone() -> None:
    diagnosis = diagnosed(LAGGED)
    assert (diagnosis.joins.effects, diagnosis.x.verdict) == ((), "none")
    assert diagnosis.y.verdict in ("named", "one_of")
    assert [effect.name for effect in diagnosis.y.effects] == ["lag"]


@pytest.mark.parametrize(
    ("device", "names"),
    [
        (two_axes(frame=FRAME), {"cross_coupling"}),
        (two_axes(cross=SHARED), {"shared_friction"}),
        (replace(LAGGED, mix=TURNED), {"misalignment"}),
        (two_axes(TURNED, FRAME), {"misalignment", "cross_coupling"}),
    ],
    ids=["frame", "friction", "turned and lagged", "turned and frame"],
)
def test_what_joins_the_axes_is_named_for_what_it_is(device: TwoAxisModel, names: set[str]) -> None:
    joins, joined = find_joins(JoinTrials.of(GIVEN, recorded(device, SEEDS), True), 1)
    assert {effect.name for effect in joins.effects} == names
    assert {name for names in joins.ambiguity for name in names} <= names
    np.testing.assert_allclose(joined.matrix, device.matrix, atol=0.02)
    np.testing.assert_allclose(joined.turn, device.turn, atol=0.01)


def test_wrong_use_gives_one_line(tmp_path: Path) -> None:
    trial = recorded(GIVEN, range(1))[0]
    one = Trial(trial.t, trial.commands[:, 0], trial.angles[:, 0], source="one")
    still = Trial(trial.t, np.zeros_like(trial.commands), trial.angles, source="still")
    tendons = GIVEN.with_tendons([0, 90, 180, 270], pretension=1.0, limits=[(0.0, 4.0)] * 4, rates_per_s=[8.0] * 4)
    (tmp_path / "other.txt").write_text("mine")
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: hystmpc.diagnose([one], GIVEN), "a log of one axis, expected two"),
        (lambda: hystmpc.diagnose([trial], GIVEN.axes[0]), "expected one of each here"),
        (lambda: hystmpc.diagnose([trial], GIVEN, confirm=tmp_path), "got --confirm and a simulator of two axes"),
        (lambda: hystmpc.diagnose([trial], GIVEN, simulated=tmp_path), "got --simulated and a simulator of two axes"),
        (lambda: hystmpc.diagnose([trial], GIVEN, without=["misalignmnt"]), "did you mean"),
        (lambda: hystmpc.diagnose([trial], GIVEN, tmp_path), "is not empty and holds no diagnosis"),
        (lambda: hystmpc.diagnose([still], GIVEN), "command x never moves"),
        (lambda: hystmpc.diagnose([trial], tendons), "a model of 4 tendons"),
    ]
    for call, expected in calls:
        with pytest.raises(HystmpcError, match=expected) as refused:
            call()
        assert len(str(refused.value)) <= 300
        assert "\n" not in str(refused.value)

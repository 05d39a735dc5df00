"""`fit` finds two axes in its logs, and refuses in a line what only one axis has."""

from __future__ import annotations

import json
from pathlib import Path
from typing import cast

import numpy as np
import pytest

import hystmpc
from hystmpc.models.two_axes.model import load_two_axes
from hystmpc.tasks.fit_both import FitOfBothAxes
from hystmpc.trials.errors import ConfigError, FitError, LogError
from hystmpc.trials.trial import Trial

from ..models.two_axis_examples import DT, recorded, two_axes


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of logs of a device whose tendons are not aligned with its axes."""
    folder = tmp_path_factory.mktemp("logs")
    for trial in recorded(two_axes(((1.0, 0.2), (-0.1, 1.0))), range(3)):
        rows = np.column_stack([trial.t, trial.commands, trial.angles])
        np.savetxt(
            folder / f"{trial.source.replace(' ', '_')}.csv",
            rows,
            delimiter=",",
            header="time_s,command_x,command_y,angle_x_deg,angle_y_deg",
            comments="",
        )
    return folder


def test_fit_finds_two_axes_and_writes_their_model(logs: Path, tmp_path: Path) -> None:
    seen, last = sorted(logs.iterdir())[:2], sorted(logs.iterdir())[2]
    steps: list[float] = []
    made = cast(
        FitOfBothAxes,
        hystmpc.fit("pi", seen, tmp_path / "both.yaml", test=last, progress=lambda *told: steps.append(told[0])),
    )
    assert made.identified.joint == "tendons"
    assert "joined by tendons" in made.report
    assert steps[0] == 0
    (_, seen_runs), (_, unseen_runs) = made.evaluations
    assert len(seen_runs) == 2
    assert all(axis.rmse_deg < 1.0 for axis in unseen_runs[0].axes)
    again = load_two_axes(tmp_path / "both.yaml")
    assert again.dt_s == pytest.approx(DT)
    np.testing.assert_allclose(again.matrix, [[1.0, 0.2], [-0.1, 1.0]], atol=0.03)
    tip = hystmpc.TipController.from_config({"model": str(tmp_path / "both.yaml")})
    assert np.shape(tip.step((0.0, 0.0)).u) == (2,)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="exists"):
        made.save(tmp_path / "both.yaml")
    made.save(tmp_path / "both.yaml", force=True)
    with pytest.raises(ConfigError, match="ending in"):
        made.save(tmp_path / "both.onnx")


def test_trials_of_two_commands_are_taken_as_they_are() -> None:
    made = cast(FitOfBothAxes, hystmpc.fit("pi", recorded(two_axes(((1.0, 0.2), (-0.1, 1.0))), range(2))))
    assert made.identified.joint == "tendons"
    three = [Trial(DT * np.arange(200), np.zeros((200, 2)), np.zeros((200, 3)))]
    with pytest.raises(LogError, match="expected one of each, or two"):
        hystmpc.fit("pi", three)
    still = [Trial(DT * np.arange(200), np.zeros((200, 3)), np.zeros((200, 2)))]
    with pytest.raises(FitError, match="does not move, expected motion of every one"):
        hystmpc.fit("pi", still)


def test_options_of_one_axis_are_refused_in_a_line(logs: Path) -> None:
    with pytest.raises(FitError, match="logs of two axes") as refused:
        hystmpc.fit("pi", logs, inverse=True)
    assert len(str(refused.value)) <= 300


def test_fit_and_evaluate_write_pages_that_name_what_joins_the_axes(logs: Path, tmp_path: Path) -> None:
    model, pages = tmp_path / "both.yaml", [tmp_path / f"{name}.html" for name in ("fit", "evaluate")]
    made = cast(FitOfBothAxes, hystmpc.fit("pi", logs, model, report=pages[0], figures=tmp_path / "figures"))
    runs = hystmpc.evaluate(model, logs, json=tmp_path / "errors.json", report=pages[1])
    assert runs.mean == made.evaluations[0][1].mean == hystmpc.evaluate(made, list(made.trials)).mean
    for page in pages:
        text = page.read_text()
        assert "What joins both axes" in text
        assert "a command moves both axes" in text
        assert "src=" not in text.replace('src="data:', "")
    assert len(list((tmp_path / "figures").glob("*.svg"))) == 2
    assert json.loads((tmp_path / "errors.json").read_text())["trials"][0]["tip"]["rmse_deg"] < 1.0


def test_logs_and_models_of_one_axis_and_two_are_not_mixed(logs: Path, tmp_path: Path) -> None:
    one = tmp_path / "one.csv"
    trial = hystmpc.read_trials(next(iter(logs.iterdir())))[0]
    hystmpc.write_csv(Trial(trial.t, trial.command, trial.angle), one)
    both = two_axes().save(tmp_path / "both.yaml")
    for call in (
        lambda: hystmpc.evaluate(both, one),
        lambda: hystmpc.evaluate("builtin:pi", logs),
        lambda: hystmpc.fit("pi", logs, test=one),
        lambda: hystmpc.fit("pi", one, test=logs),
    ):
        with pytest.raises(LogError, match=r"one axis|two axes") as refused:
            call()
        assert len(str(refused.value)) <= 300


def test_a_kind_without_a_readable_form_is_refused_in_a_line(logs: Path) -> None:
    with pytest.raises(FitError, match="no readable form"):
        hystmpc.fit("play_kernel", logs)

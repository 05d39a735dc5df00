"""`fit` finds two axes in its logs, and refuses in a line what only one axis has."""

from __future__ import annotations

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
    assert made.unseen_deg is not None
    assert np.all(made.unseen_deg < 1.0)
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
    three = [Trial(DT * np.arange(200), np.zeros((200, 3)), np.zeros((200, 2)))]
    with pytest.raises(LogError, match="expected one of each, or two"):
        hystmpc.fit("pi", three)


@pytest.mark.parametrize("given_", [{"inverse": True}, {"report": "page.html"}])
def test_options_of_one_axis_are_refused_in_a_line(logs: Path, tmp_path: Path, given_: dict[str, object]) -> None:
    options = {name: tmp_path / value if isinstance(value, str) else value for name, value in given_.items()}
    with pytest.raises(FitError, match="logs of two axes") as refused:
        hystmpc.fit("pi", logs, **options)  # type: ignore[arg-type]
    assert len(str(refused.value)) <= 300


def test_a_kind_without_a_readable_form_is_refused_in_a_line(logs: Path) -> None:
    with pytest.raises(FitError, match="no readable form"):
        hystmpc.fit("play_kernel", logs)

"""A commissioning of two axes as a whole: limits, files, what joins the axes, the model on a motion left out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import hystmpc
from hystmpc.bench import identify, phases, plane
from hystmpc.bench.commission import NAMES
from hystmpc.bench.motions import CONTROLLERS
from hystmpc.bench.plane import turns_deg
from hystmpc.models.kinds.catalogue import chosen_kind
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.two_axes.evaluate import evaluate_two_axes
from hystmpc.models.two_axes.identify import fit_two_axes
from hystmpc.models.two_axes.joints import Chosen, Joint
from hystmpc.models.two_axes.model import load_two_axes
from hystmpc.sim.tuning import gains
from hystmpc.trials.axes import both_axes
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..cli.test_verbs import run
from ..models.two_axis_examples import recorded
from .small_commission import make_quick
from .small_plane import Pair, commissioned_plane, plane_settings, require_within, turned

TURN_DEG = 10.0
Whole = tuple[Path, list[Pair]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    """The folder of a commissioning that nothing has interrupted, and every pair of commands that the device got."""
    with pytest.MonkeyPatch.context() as patch:
        make_quick(patch)
        patch.setattr(phases, "HOLD_S", 0.3)
        patch.setattr(identify, "_TUNED_S", 1.0)
        patch.setattr(gains, "_PER_PARAMETER", 1)
        patch.setattr(plane, "evaluations", lambda subject: {"pid": 4, "inverse_pid": 4})
        folder, sent = tmp_path_factory.mktemp("whole"), list[Pair]()
        commissioned_plane(plane_settings(folder, turned(TURN_DEG)), folder / "run", sent)
    return folder / "run", sent


def trials_of(folder: Path, *names: str) -> list[Trial]:
    """Recordings of a commissioning with both commands and angles."""
    return both_axes(read_trials([folder / NAMES[1] / "trials" / f"{name}.csv" for name in names])) or []


def test_no_command_is_beyond_a_limit_and_both_axes_end_at_the_safe_command(whole: Whole) -> None:
    out, sent = whole
    require_within(sent, plane_settings(out.parent))
    assert sent[-1] == pytest.approx((0.0, 0.0), abs=1e-9)
    spent = json.loads((out / "device_time.json").read_text())["seconds"]
    assert spent <= 60.0 * plane_settings(out.parent).commission.minutes
    corners = {(np.sign(x), np.sign(y)) for x, y in sent if min(abs(x), abs(y)) > 2.5}
    assert len(corners) == 4


def test_it_writes_the_files_of_one_axis_and_a_controller_that_steps(whole: Whole) -> None:
    out, _ = whole
    assert all((out / name / "result.json").exists() for name in NAMES if name != "5-diagnose")
    assert all((out / NAMES[5] / f"{name}.yaml").exists() for name in ("pid", "inverse", "inverse_pid"))
    verified = json.loads((out / NAMES[6] / "result.json").read_text())["result"]
    assert set(verified["scores"]) == set(CONTROLLERS)
    assert all(score["beyond"] == 0 for score in verified["scores"].values())
    assert verified["scores"]["mpc"]["rms_deg"] < verified["scores"]["pid"]["rms_deg"]
    html = (out / "report.html").read_text(encoding="utf-8")
    assert "What joins both axes" in html
    assert "angle y" in html
    tip = hystmpc.TipController.from_config(out / "tip.yaml")
    tip.set_target((5.0, -5.0))
    assert np.all(np.abs(tip.step((0.0, 0.0)).u) <= np.array([8.0, 6.0]) * tip.dt + 1e-9)


def test_turned_tendons_are_found_within_a_degree(whole: Whole) -> None:
    """The tendons alone: the sensor's frame is aligned with the axes, and the model says so."""
    model = load_two_axes(whole[0] / NAMES[3] / "model.yaml")
    assert turns_deg(model.mix) == pytest.approx((-TURN_DEG, -TURN_DEG), abs=1.0)
    assert turns_deg(model.frame) == pytest.approx((0.0, 0.0), abs=1.0)


def test_the_model_is_as_good_on_a_motion_left_out_as_one_of_generous_logs(whole: Whole) -> None:
    """Within 1.3: the other one gets longer logs, and what truly joins the axes."""
    out, _ = whole
    (left_out,) = trials_of(out, "left_out")
    model, device = load_two_axes(out / NAMES[3] / "model.yaml"), load_two_axes(out.parent / "both.yaml")
    kind, order = chosen_kind("pi", None, None), np.eye(2)
    true = Chosen(Joint("tendons", order, device.matrix, device.turn), {})
    logs = recorded(device, range(6), noise=0.1)
    generous = fit_two_axes(kind, logs, FitRequest(training=kind.usual_training(False)), joint=true)
    mine, other = (evaluate_two_axes(one, left_out).errors.rmse_deg for one in (model, generous.model))
    assert mine <= 1.3 * other


def test_the_motion_left_out_is_no_part_of_the_fit(whole: Whole) -> None:
    out, _ = whole
    names = json.loads((out / NAMES[1] / "result.json").read_text())["result"]["names"]
    assert names[-1] == "left_out"
    fitted = json.loads((out / NAMES[3] / "result.json").read_text())["result"]
    (trial,) = trials_of(out, "left_out")
    model = load_two_axes(out / NAMES[3] / "model.yaml")
    assert fitted["left_out_deg"] == pytest.approx(evaluate_two_axes(model, trial).errors.rmse_deg, rel=1e-6)


def alone(trial: Trial) -> Vec:
    """Which commands move (2,)."""
    return np.ptp(trial.commands, axis=0) > 0


def test_each_axis_is_recorded_alone_and_both_together(whole: Whole) -> None:
    out, _ = whole
    names = json.loads((out / NAMES[1] / "result.json").read_text())["result"]["names"]
    moved = {name: tuple(alone(trial)) for name, trial in zip(names, trials_of(out, *names), strict=True)}
    assert sum(axes == (True, False) for axes in moved.values()) == 6
    assert sum(axes == (False, True) for axes in moved.values()) == 6
    assert sum(axes == (True, True) for axes in moved.values()) == 5


def test_a_complete_one_moves_nothing_more_and_its_report_is_written_again(
    whole: Whole, capsys: pytest.CaptureFixture[str]
) -> None:
    out, sent = whole[0], list[Pair]()
    made = commissioned_plane(plane_settings(out.parent), out, sent)
    assert (sent, made.verified is not None, "tendons turned by" in made.joined) == ([], True, True)
    (out / "report.html").unlink()
    assert run(capsys, "report", out)[0] == 0
    assert (out / "report.html").exists()

"""Laws of an investigation of two axes: limits and device time are kept, it goes on to the same result, it names."""

from __future__ import annotations

import json
import signal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.bench import round_plan, stages
from hystmpc.bench.config import PlaneInvestigateSettings, located_investigation
from hystmpc.bench.device import BenchDevice, DeviceStoppedError, MovableDevice, plants_in
from hystmpc.bench.investigate import identification_share, investigate_device, plan_rows
from hystmpc.bench.plane_rounds import (
    KINDS_OF_BOTH,
    AxisView,
    PlanePlanner,
    joins_verdict,
    planned_commands_of_both,
)
from hystmpc.bench.report import write_investigation
from hystmpc.bench.rounds import Investigated, JoinVerdict, PlaneVerdict
from hystmpc.gap.next.motion_design import SearchSettings
from hystmpc.gap.two_axes.diagnosis import JoinGap, KnownJoins
from hystmpc.models.load import library_file
from hystmpc.models.two_axes.model import TwoAxisModel, load_two_axes
from hystmpc.rig.run import reset_latch
from hystmpc.trials.errors import ConfigError, FitError, HystmpcError, LogError, ModelError
from hystmpc.trials.recording import recorded_trials

from ..models.two_axis_examples import two_axes
from .small_plane import PLANE, Angle, Pair, SpiedPlane, require_within, turned

GIVEN = two_axes()
LAG = {"y": {"effects": [{"effect": "lag", "parameters": {"tau_s": 0.25}}]}}


def settings(folder: Path, model: TwoAxisModel = GIVEN, device: TwoAxisModel = GIVEN, **changes: Any) -> Any:
    """The bench with its device, its simulator and its latch in a folder; `investigate` is changed key by key."""
    model.save(folder / "model.yaml")
    device.save(folder / "device.yaml")
    plant = {"simulator": str(folder / "device.yaml"), "noise_deg": 0.1, **LAG}
    data = {key: value for key, value in PLANE.items() if key != "commission"}
    data |= {"plausibility": {"travel": 3.0}, "latch_file": str(folder / "latch.json")}
    data |= {"transport": {"kind": "simulated", "plant": plant}} | changes
    block = {"model": str(folder / "model.yaml"), "minutes": 3.0, "first_motions": 2, "longest_motion_s": 10.0}
    data["investigate"] = block | changes.get("investigate", {})
    return located_investigation(PlaneInvestigateSettings.parse(data), Path())


def investigated(
    made: PlaneInvestigateSettings, out: Path, sent: list[Pair], angle: Angle = lambda k, u, y: y
) -> Investigated:
    """An investigation of that device, behind a spy that keeps every pair of commands."""
    plants = plants_in(Path(), made.command_unit)

    def spied(block: Any, dt_s: float) -> Any:
        plant, held = plants(block, dt_s)
        return SpiedPlane(plant, sent, angle), held

    def device(root: Path, tick: Any) -> MovableDevice:
        return BenchDevice(made, spied, root, made.commission.angle_limits_deg)

    return investigate_device(made, device, out)


@pytest.mark.parametrize("degrees", [0.0, 20.0])
def test_the_first_motions_are_within_limits_and_time_and_move_one_command_or_both(
    degrees: float, tmp_path: Path
) -> None:
    made = settings(tmp_path, turned(degrees), safe_command=[0.5, -0.5])
    plan = PlanePlanner(made, turned(degrees), 120.0, tmp_path).first()
    assert plan.both == (f"1-{KINDS_OF_BOTH[0]}",)
    assert 0 < plan.seconds <= 120.0
    moved = set()
    for name in plan.motions:
        commands = planned_commands_of_both(tmp_path, name)
        require_within([tuple(u) for u in commands.tolist()], made)
        assert commands[0] == pytest.approx((0.5, -0.5))
        assert commands[-1] == pytest.approx((0.5, -0.5))
        alone = tuple(np.ptp(commands, axis=0) > 0)
        assert alone == {"x": (True, False), "y": (False, True)}.get(name.rpartition("_")[2], (True, True))
        moved.add(alone)
        with pytest.raises(LogError, match="is a motion proposed by a diagnosis"):
            recorded_trials(tmp_path / f"{name}.csv", most_axes=2)
    assert len(moved) == 3


def test_a_motion_of_an_axis_is_the_travel_that_was_planned(tmp_path: Path) -> None:
    model = turned(25.0)
    made = settings(tmp_path, model, safe_command=[0.5, -0.5])
    for axis in range(2):
        view = AxisView.of(made, model, axis)
        (limits,) = view.bench.axes_limits
        steps = int((limits.upper - view.bench.safe_command) / (limits.rate * made.dt_s)) + 1
        travels = np.linspace(view.bench.safe_command, limits.upper, 2 * steps)
        commands = view.commands(made, travels)
        np.testing.assert_allclose(model.travels(commands)[:, axis], travels, atol=1e-6)
        require_within([tuple(u) for u in commands.tolist()], made)


def test_the_plan_fills_the_minutes_and_moves_nothing(tmp_path: Path) -> None:
    rows = plan_rows(settings(tmp_path))
    assert [name for name, _, _ in rows] == ["round 1", "further rounds", "all"]
    assert sum(minutes for _, _, minutes in rows[:-1]) == pytest.approx(3.0)
    none = settings(tmp_path, investigate={"model": None, "minutes": 20.0})
    assert 0.3 < identification_share(none) <= 1.0
    rows = plan_rows(none)
    assert [name for name, _, _ in rows[:2]] == ["identify", "round 1"]
    assert rows[1][2] * 60.0 > 5 * 8.0  # two motions of each axis and one of both


@pytest.mark.slow
def test_a_turned_device_with_a_lag_in_y_is_named_and_an_interruption_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hystmpc.gap.report.page.write_report", lambda *arguments: None)  # figures that take seconds
    monkeypatch.setattr(round_plan, "SearchSettings", partial(SearchSettings, generations=1))
    made, sent, out = settings(tmp_path, device=turned(10.0)), list[Pair](), tmp_path / "run"
    real, calls = stages.write_recording, list[int]()

    def interrupted(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(stages, "write_recording", interrupted)
    with pytest.raises(KeyboardInterrupt):
        investigated(made, out, sent)
    kept = {file: file.read_bytes() for file in out.glob("round-*/record/trials/*.csv")}
    assert len(kept) == 2
    found = investigated(made, out, sent)
    assert {file: file.read_bytes() for file in kept} == kept
    require_within(sent, made)
    assert sent[-1] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert found.device_s <= made.budget_s
    assert found.device_s == pytest.approx(len(sent) * made.dt_s, abs=2.0)
    last = found.verdict
    assert isinstance(last, PlaneVerdict)
    assert (last.joins.effects, last.x.verdict, last.y.effects) == (("misalignment",), "none", ("lag",))
    assert last.left_deg < 0.2 * last.retuned_deg
    assert found.fixed is not None
    np.testing.assert_allclose(load_two_axes(found.fixed).matrix, turned(10.0).matrix, atol=0.02)
    assert json.loads((out / "investigation.json").read_text()) == found.as_json()
    page = found.report.read_text(encoding="utf-8")
    assert all(f"Round {one.number}" in page for one in found.rounds)
    second = found.rounds[1].plan
    assert {name.rpartition("_")[2] for name in second.motions} == {"x", "y", "8-circles"}
    count = len(sent)
    assert investigated(made, out, sent).as_json() == found.as_json()
    assert len(sent) == count  # complete: nothing moves again
    late = next(iter(kept))  # a sample that a real clock has missed
    rows = late.read_text(encoding="utf-8").splitlines(keepends=True)
    late.write_text("".join(rows[:50] + rows[51:]), encoding="utf-8")
    found.report.unlink()
    assert write_investigation(found, made.name, made.command_unit).exists()


HELD_OUT = {"as given": 1.0, "misalignment": 0.5}
JOINED = JoinVerdict((), (), "", next="8-circles")


@pytest.mark.parametrize(
    ("held_out", "ambiguity", "before", "recorded", "in_time", "expected"),
    [
        ({"as given": 1.0, "misalignment": 0.95}, (), [JOINED], KINDS_OF_BOTH[:2], True, ("no_gap", "")),
        ({"as given": 1.0}, (), [], KINDS_OF_BOTH[:1], True, ("", "9-circles")),
        (HELD_OUT, (), [JOINED], KINDS_OF_BOTH[:1], True, ("", "9-circles")),
        (HELD_OUT, (), [JOINED], KINDS_OF_BOTH, True, ("nothing_gained", "")),
        (HELD_OUT, (), [JOINED], KINDS_OF_BOTH[:1], False, ("budget", "")),
        ({"as given": 1.0}, (("a", "b"),), [JOINED], KINDS_OF_BOTH[:1], True, ("", "9-circles")),
    ],
)
def test_what_joins_the_axes_is_open_until_two_rounds_agree_and_no_effect_is_likely(
    held_out: dict[str, float],
    ambiguity: tuple[tuple[str, ...], ...],
    before: list[JoinVerdict],
    recorded: tuple[str, ...],
    in_time: bool,
    expected: tuple[str, str],
) -> None:
    """An effect that lowers the error without being sure leaves them open: nothing is called joined as in the model."""
    gap = JoinGap(1.0, 1.0, 1.0, 1.0, 0.1, ())
    judged = joins_verdict(KnownJoins((), ambiguity, gap, held_out), before, 9, recorded, in_time)
    assert (judged.ended, judged.next) == expected
    assert ("is open" in judged.headline) == (held_out is HELD_OUT)


def test_ctrl_c_in_a_motion_leaves_both_axes_at_the_safe_command(tmp_path: Path) -> None:
    made, sent, out = settings(tmp_path), list[Pair](), tmp_path / "run"

    def angle(count: int, u: Any, y: Any) -> Any:
        if count == 500:
            signal.raise_signal(signal.SIGINT)
        return y

    with pytest.raises(DeviceStoppedError, match="SIGINT") as stopped:
        investigated(made, out, sent, angle)
    assert stopped.value.result.outcome.confirmed
    assert sent[-1] == pytest.approx((0.0, 0.0), abs=1e-9)
    require_within(sent, made)
    assert list(out.glob("round-1/record/trials/*.csv"))
    assert not (out / "round-1" / "record" / "result.json").exists()
    with pytest.raises(ConfigError, match="latched"):
        investigated(made, out, sent)
    reset_latch(made)


@pytest.mark.parametrize(
    ("changes", "expected", "kind"),
    [
        ({"investigate": {"minutes": 0.5}}, "more minutes, or fewer first_motions", ConfigError),
        ({"investigate": {"model": None}}, "more minutes, or --model", ConfigError),
        ({"investigate": {"model": "none.yaml"}}, "none.yaml", HystmpcError),
        ({"investigate": {"model": str(library_file("pi"))}}, "expected a model of two axes", ModelError),
        ({"command_unit": "bar"}, "takes commands in mm", ModelError),
        ({"commission": {"angle_limits_deg": [-1, 1]}}, "the angle limits", FitError),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_moves(
    changes: dict[str, Any], expected: str, kind: type[Exception], tmp_path: Path
) -> None:
    sent = list[Pair]()
    with pytest.raises(kind, match=expected) as refused:
        investigated(settings(tmp_path, **changes), tmp_path / "run", sent)
    assert len(str(refused.value)) <= 300
    assert "\n" not in str(refused.value)
    assert sent == []

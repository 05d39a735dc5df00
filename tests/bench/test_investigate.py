"""Laws of an investigation: limits and device time are kept, it goes on to the same result, it ends with a reason."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hystmpc.bench import round_plan, stages
from hystmpc.bench.config import InvestigateSettings
from hystmpc.bench.investigate import identification_share, plan_rows
from hystmpc.bench.round_plan import RoundPlanner
from hystmpc.bench.rounds import Investigated
from hystmpc.gap.next.motion_design import Noise, OpenHypothesis, SearchSettings
from hystmpc.gap.next.motions import TEMPLATES
from hystmpc.gap.next.open_hypotheses import DiscriminationTask
from hystmpc.models.load import model_path
from hystmpc.models.simulator import load_simulator
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.errors import ConfigError, FitError, HystmpcError, ModelError

from .small_commission import within
from .small_investigate import bench, investigated, settings

SIMULATOR = load_simulator(model_path("builtin:tendon-catheter"))


def recorded(out: Path) -> dict[str, bytes]:
    return {str(f.relative_to(out)): f.read_bytes() for f in sorted(out.glob("round-*/record/trials/*.csv"))}


def story(made: Investigated) -> dict[str, object]:
    return made.as_json()


def check_laws(made: Investigated, settings: InvestigateSettings, sent: list[float]) -> None:
    assert within(sent, settings)
    assert made.device_s <= settings.budget_s
    assert made.device_s == pytest.approx(len(sent) * settings.dt_s, abs=2.0)
    assert made.ended
    assert made.why
    assert json.loads((made.folder / "investigation.json").read_text()) == made.as_json()
    page = made.report.read_text()
    assert made.why in page
    assert all(f"Round {found.number}" in page for found in made.rounds)


@pytest.mark.slow
def test_interrupted_it_goes_on_to_the_same_result_and_ends_with_the_device_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a minute, and a device as its simulator says: one round, and no time for another."""
    monkeypatch.setattr("hystmpc.gap.report.page.write_report", lambda *arguments: None)  # figures that take seconds
    changes = {"transport": {"kind": "simulated", "plant": {"simulator": "builtin:tendon-catheter"}}}
    block = {"minutes": 0.56, "first_motions": 2}
    short, sent = settings(tmp_path, investigate=block, **changes), list[float]()
    out = tmp_path / "run"
    real, calls = stages.write_csv, []

    def interrupted(*arguments: object) -> object:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(stages, "write_csv", interrupted)
    with pytest.raises(KeyboardInterrupt):
        investigated(short, out, sent)
    kept = recorded(out)
    assert len(kept) == 1
    made = investigated(short, out, sent)
    check_laws(made, short, sent)
    assert made.ended == "budget"
    assert {name: recorded(out)[name] for name in kept} == kept
    moved = len(sent)
    assert story(investigated(short, out, sent)) == story(made)
    assert len(sent) == moved  # complete: nothing moves again
    with pytest.raises(ConfigError, match=r"investigate.seed 1, now it is 2"):
        investigated(settings(tmp_path, investigate=block | {"seed": 2}, **changes), out, sent)


@pytest.mark.slow
def test_a_lag_is_named_in_two_minutes_and_the_story_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hystmpc.gap.report.page.write_report", lambda *arguments: None)  # figures that take seconds
    monkeypatch.setattr(round_plan, "SearchSettings", partial(SearchSettings, generations=1))
    two, sent = settings(tmp_path, investigate={"minutes": 2.0}), list[float]()
    made = investigated(two, tmp_path / "run", sent)
    check_laws(made, two, sent)
    assert (made.ended, made.verdict.effects) == ("named", ("lag",))
    assert len(made.rounds) >= 2
    assert made.fixed is not None
    assert any(operator.name == "lag" for operator in load_simulator(made.fixed).chain.before)
    first, second = made.rounds[0], made.rounds[1]
    assert "lag" in second.plan.separates
    assert first.recorded.names[0].partition("-")[2] == first.recorded.names[-1].partition("-")[2]


def test_the_plan_is_within_limits_and_time_and_needs_no_angle(tmp_path: Path) -> None:
    rows = plan_rows(settings(tmp_path))
    assert rows[-1] == ("all", "at most", 1.0)
    assert sum(minutes for _, _, minutes in rows[:-1]) == pytest.approx(1.0)
    made = settings(tmp_path, safe_command=1.0)
    first = RoundPlanner(made, SIMULATOR, 60.0, tmp_path).first()
    assert 0 < first.seconds <= 0.6 * 60.0
    assert first.probability > 2 / len(first.separates)
    for name in first.motions:
        commands = read_csv(tmp_path / f"{name}.csv").command
        assert within(commands.tolist(), made)
        assert commands[0] == commands[-1] == 1.0


@pytest.mark.slow
def test_a_further_motion_is_of_a_kind_that_was_not_recorded_and_what_was_fitted_allows_it(tmp_path: Path) -> None:
    made, left = settings(tmp_path, investigate={"minutes": 5.0}), "dwell_near_lowest"
    kinds = {template.name for template in TEMPLATES}
    further = RoundPlanner(made, SIMULATOR, 200.0, tmp_path).further(None, 4, kinds - {left})
    assert further is not None
    assert further.motions == (f"4-{left}",)
    assert further.undirected
    assert further.seconds <= 200.0
    assert within(read_csv(tmp_path / f"4-{left}.csv").command.tolist(), made)
    assert RoundPlanner(made, SIMULATOR, 200.0, tmp_path).further(None, 4, kinds) is None
    assert RoundPlanner(made, SIMULATOR, 5.0, tmp_path).further(None, 4, ()) is None
    outside = OpenHypothesis("outside", lambda command, dt: np.full(command.size, 1e3))
    asked = DiscriminationTask((outside, outside), Noise(0.1))
    assert RoundPlanner(made, SIMULATOR, 200.0, tmp_path).further(asked, 4, kinds - {left}) is None


def test_without_a_simulator_time_is_kept_for_recordings_to_identify_one(tmp_path: Path) -> None:
    none = settings(tmp_path, investigate={"model": None, "minutes": 5.0})
    assert 0.4 < identification_share(none) < 1.0
    assert [name for name, _, _ in plan_rows(none)] == ["identify", "round 1", "further rounds", "all"]
    with pytest.raises(ConfigError, match="more minutes, or --model"):
        identification_share(settings(tmp_path, investigate={"model": None}))


@pytest.mark.parametrize(
    ("changes", "expected", "kind"),
    [
        ({"investigate": {"minutes": 0.3}}, "more minutes, or fewer first_motions", ConfigError),
        ({"investigate": {"model": "none.yaml"}}, "none.yaml", HystmpcError),
        ({"command_unit": "bar"}, "takes commands in mm", ModelError),
        ({"commission": {"angle_limits_deg": [60, 70]}}, "leaves the angle limits", FitError),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_moves(
    changes: dict[str, object], expected: str, kind: type[Exception], tmp_path: Path
) -> None:
    sent = list[float]()
    with pytest.raises(kind, match=expected):
        investigated(settings(tmp_path, **changes), tmp_path / "run", sent)
    assert sent == []


def test_unknown_keys_are_errors() -> None:
    with pytest.raises(ConfigError, match="minute"):
        InvestigateSettings.parse(bench(investigate={"minute": 3}))


class Clocked:
    """A device of which only the time counts."""

    in_real_time, used_s = True, 0.0


@dataclass(frozen=True)
class Computed:
    """The result of a computation."""


def test_the_bar_counts_computations_and_never_goes_back(tmp_path: Path) -> None:
    """Rounds beyond the expected number make the total longer, and nothing of it is past the end."""
    told, clocked = list[tuple[float, float]](), Clocked()
    counted = stages.Stages(
        tmp_path,
        {},
        lambda root, tick: clocked,  # type: ignore[arg-type,return-value]
        lambda done, total, note="": told.append((done, total)),
    )
    counted.expect(300.0, 3 * 60.0)

    def compute(folder: Path) -> Computed:
        step = counted.computing(f"{folder.name}: diagnose")
        for share in (0.25, 0.5, 1.0):
            step(share, 1.0, "lag/command")
        return Computed()

    for k in range(6):
        clocked.used_s += 40.0
        counted.say("moving")
        counted.complete(f"round-{k + 1}", Computed, compute, 60.0)
    done = [value for value, _ in told]
    assert done == sorted(done)
    assert done[-1] == 6 * (40.0 + 60.0)
    assert all(value <= total for value, total in told)
    assert told[0][1] == 300.0 + 3 * 60.0

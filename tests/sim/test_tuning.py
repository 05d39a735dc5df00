"""The objective, the search in a shared storage, and whether it helps on plants that it has not seen."""

from __future__ import annotations

import multiprocessing
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl.config import CONTROLLERS, parse_controller
from hystmpc.sim.compare import compare
from hystmpc.sim.config import load_simulation
from hystmpc.sim.jobs import InTurn, Processes
from hystmpc.sim.study import prepare
from hystmpc.sim.tuning.objective import (
    PlantScore,
    SearchTrial,
    Tuning,
    needed_travel,
    pareto_front,
    plant_config,
    plant_cost,
    robust,
)
from hystmpc.sim.tuning.run import run_tuning, search
from hystmpc.sim.tuning.settings import ObjectiveSettings, TuneSettings, complete
from hystmpc.trials.config import dump_yaml, load_settings, read_yaml
from hystmpc.trials.errors import ConfigError

from ..trials.test_html import Page
from .small import SCAN, study, study_data

pytestmark = pytest.mark.slow

POSIX = pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")
BASE = study_data(motions={"scan": SCAN}, controllers={"pid": {"kind": "pid"}})
costs = st.lists(st.floats(0.0, 100.0), min_size=1, max_size=30)


def data(**changes: Any) -> dict[str, Any]:
    """A tuning of a PID on three plants with different lags."""
    plain: dict[str, Any] = {
        "base": BASE,
        "draw": {"plant.lag_s": {"uniform": [0.0, 0.1]}},
        "plants": {"count": 3, "seed": 1},
        "held_out": {"count": 4, "seed": 2},
        "trials": 6,
    }
    return plain | changes


def tuning(**changes: Any) -> TuneSettings:
    return complete(TuneSettings.parse(data(**changes)), Path("tune.yaml"))


@given(values=costs, share=st.floats(0.01, 1.0), mean=st.floats(0.0, 1.0), tail=st.floats(0.01, 1.0))
def test_the_objective_lies_between_mean_and_worst_and_does_not_know_the_order(
    values: list[float], share: float, mean: float, tail: float
) -> None:
    objective = ObjectiveSettings(mean=mean, tail=tail, tail_share=share)
    found = robust(values, objective)
    assert np.mean(values) - 1e-9 <= found <= max(values) + 1e-9
    assert robust(values[::-1], objective) == pytest.approx(found)


@given(values=costs, more=st.floats(0.0, 10.0), k=st.integers(0, 29))
def test_no_plant_that_gets_worse_makes_the_objective_better(values: list[float], more: float, k: int) -> None:
    worse = list(values)
    worse[k % len(values)] += more
    assert robust(worse, ObjectiveSettings()) >= robust(values, ObjectiveSettings()) - 1e-9


def test_the_worst_tenth_of_twenty_plants_are_two() -> None:
    objective = ObjectiveSettings(mean=0.0, tail=1.0, tail_share=0.1)
    assert robust([*range(18), 30.0, 40.0], objective) == 35.0


def test_violations_and_chatter_cost_and_needed_travel_does_not() -> None:
    objective = ObjectiveSettings(violation_deg=10.0, chatter_deg=0.1)
    assert plant_cost(PlantScore(0.5, 1.0, 0), objective) == 0.5
    assert plant_cost(PlantScore(0.5, 0.2, 0), objective) == 0.5
    assert plant_cost(PlantScore(0.5, 3.0, 0), objective) == pytest.approx(0.7)
    assert plant_cost(PlantScore(0.5, 1.0, 2), objective) == 10.5


def test_the_need_of_a_motion_is_the_travel_of_the_inverse_on_the_plant_that_the_model_describes() -> None:
    config = study(
        model="builtin:tendon-catheter", motions={"scan": SCAN}, controllers={"inverse": {"kind": "inverse"}}
    )
    travelled = compare(config).results[0].metrics.command_travel
    assert needed_travel(prepare(config), "scan") == pytest.approx(travelled, rel=0.05)


points = st.lists(st.tuples(st.floats(0.1, 5.0), st.floats(0.1, 5.0)), min_size=1, max_size=30)


@given(points=points)
def test_the_front_holds_exactly_the_trials_that_no_other_beats(points: list[tuple[float, float]]) -> None:
    trials = [SearchTrial(k, "done", error, {}, error, travel, 3) for k, (error, travel) in enumerate(points)]
    front = {(t.error_deg, t.travel) for t in pareto_front([*trials, SearchTrial(99, "pruned", 0, {}, 0.0, 0.0, 1)])}
    expected = {(e, t) for e, t in points if not any((a <= e and b <= t) and (a < e or b < t) for a, b in points)}
    assert front == expected


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_every_kind_of_controller_has_a_space_that_fits_it(kind: str) -> None:
    settings = tuning(base=BASE | {"controllers": {"c": {"kind": kind}}})
    assert settings.search
    for path, one in settings.search.items():
        assert len({settings.with_values({path: end}).model_dump_json() for end in one.ends}) == 2


def test_plants_left_out_are_drawn_in_lag_noise_and_every_parameter() -> None:
    settings = tuning(draw={})
    first = plant_config(settings, settings.plants, 0, settings.given)
    second = plant_config(settings, settings.plants, 1, settings.given)
    held = plant_config(settings, settings.held_out, 0, settings.given)
    assert len(first.plant.mismatch) > 3
    assert len({c.plant.lag_s for c in (first, second, held)}) == 3
    assert len({c.seed for c in (first, second, held)}) == 3
    prepare(first)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"trails": 5}, "unknown key 'trails'.*did you mean 'trials'"),
        ({"controller": "pdi"}, "'pdi'.*did you mean 'pid'"),
        (
            {"search": {"gains.kp_deg": {"uniform": [0, 1]}}},
            r"line \d+: search: .*did you mean 'kp_per_deg'",
        ),
        ({"search": {"gains.kp_per_deg": {"uniform": [-1, 1]}}}, r"line \d+: search.*greater than or equal to 0"),
        ({"draw": {"plant.leg_s": {"uniform": [0, 1]}}}, r"line \d+: draw: .*'leg_s'.*did you mean 'lag_s'"),
        ({"held_out": {"count": 4, "seed": 1}}, "expected another"),
        ({"objective": {"mean": 0, "tail": 0}}, "expected one of them positive"),
        ({"pruner": "sometimes"}, "pruner"),
    ],
)
def test_wrong_settings_are_one_line(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    file = tmp_path / "tune.yaml"
    file.write_text(dump_yaml(data(**changes)), encoding="utf-8")
    with pytest.raises(ConfigError, match=message) as error:
        complete(load_settings(TuneSettings, file), file)
    assert "\n" not in str(error.value)
    assert str(file) in str(error.value)


def test_a_storage_that_is_none_is_one_line() -> None:
    pytest.importorskip("optuna", reason="optuna is an extra")
    with pytest.raises(ConfigError, match="--storage nosuch://x: cannot be opened"):
        search(tuning(), InTurn(), "nosuch://x")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Tuning]:
    """A short tuning made in one go in this process."""
    pytest.importorskip("optuna", reason="optuna is an extra")
    folder = tmp_path_factory.mktemp("tune") / "whole"
    return folder, run_tuning(tuning(trials=14), folder, InTurn())


@pytest.mark.slow
def test_a_tuning_leaves_a_controller_that_a_study_takes(whole: tuple[Path, Tuning]) -> None:
    folder, found = whole
    controller = parse_controller(read_yaml(folder / "controller.yaml"))
    assert controller == found.settings.with_values(dict(found.best.values))
    again = load_simulation(folder / "study.yaml")
    assert dict(again.controllers) == {"given": found.settings.given, "tuned": controller}
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    assert page.open == []
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    assert page.tags.count("svg") == 4


@pytest.mark.slow
def test_the_first_trial_has_the_settings_given_and_the_best_is_no_worse(whole: tuple[Path, Tuning]) -> None:
    _, found = whole
    assert found.settings.with_values(dict(found.trials[0].values)) == found.settings.given
    assert [trial.slot for trial in found.trials] == list(range(14))
    assert found.best.value <= found.trials[0].value
    assert {trial.plants for trial in found.trials if trial.state == "done"} == {3}


@pytest.mark.slow
def test_tuning_helps_on_plants_that_it_has_not_seen(whole: tuple[Path, Tuning]) -> None:
    """The honest figure with its spread over seeds stands in docs/howto/tuning.md."""
    check = whole[1].check
    assert check.gain > 0.1
    assert check.interval()[0] > 0.0


@pytest.mark.slow
def test_a_tuning_goes_on_where_it_was_stopped(whole: tuple[Path, Tuning], tmp_path: Path) -> None:
    told: list[float] = []

    def interrupt(done: float, total: float, note: str) -> None:
        told.append(done)
        if len(told) == 3:
            raise KeyboardInterrupt

    folder = tmp_path / "tune"
    with pytest.raises(KeyboardInterrupt):
        run_tuning(tuning(trials=14), folder, InTurn(), progress=interrupt)
    assert not (folder / "controller.yaml").exists()
    found = run_tuning(tuning(trials=14), folder, InTurn())
    assert [trial.values for trial in found.trials] == [trial.values for trial in whole[1].trials]
    assert found.best.values == whole[1].best.values


@pytest.mark.slow
@POSIX
def test_a_killed_worker_costs_no_trial_and_doubles_none(tmp_path: Path) -> None:
    optuna_ = pytest.importorskip("hystmpc.sim.tuning.optuna_", reason="optuna is an extra")
    import optuna

    killed: list[int] = []

    def kill(done: int, total: int, note: str) -> None:
        if not killed:
            killed.append(done)
            os.kill(int(multiprocessing.active_children()[0].pid or 0), signal.SIGKILL)

    storage = f"sqlite:///{tmp_path / 'search.db'}"
    settings = tuning(trials=4, pruner="none")
    trials, failed = search(settings, Processes(2, "test"), storage, kill)
    assert killed
    assert failed == ()
    assert [trial.slot for trial in trials] == list(range(4))
    ended = [
        trial.user_attrs["slot"]
        for trial in optuna_.open_search(storage, f"hystmpc-{settings.fingerprint}").get_trials()
        if trial.state is optuna.trial.TrialState.COMPLETE
    ]
    assert sorted(ended) == list(range(4))

"""Sweeps, searches of gains and tunings of two axes: the laws of one axis, with errors of the tip, of x and of y."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hystmpc
from hystmpc.ctrl.config import CONTROLLERS, parse_controller
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.sim.jobs import InTurn
from hystmpc.sim.results import load_results
from hystmpc.sim.sweep.plan import SweepPlan, result_columns
from hystmpc.sim.sweep.report import SweepView
from hystmpc.sim.sweep.run import SweepOutcome, reproduce, run_sweep
from hystmpc.sim.sweep.settings import SweepSettings, load_sweep, with_base
from hystmpc.sim.sweep.table import table_of
from hystmpc.sim.tuning.objective import Tuning, needed_travel
from hystmpc.sim.tuning.run import run_tuning
from hystmpc.sim.tuning.settings import TuneSettings, complete
from hystmpc.sim.two_axes.config import TwoAxisSimulationConfig
from hystmpc.sim.two_axes.study import prepare_two_axes
from hystmpc.trials.config import dump_yaml, read_yaml
from hystmpc.trials.errors import ConfigError, HystmpcError

from ..models.two_axis_examples import SHARED, two_axes

ALONE = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)))
JOINED = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)), SHARED)
CIRCLE = {"kind": "circle", "centre": [0, 0], "radius": 9, "period_s": 1.5}
PID = {"kind": "pid", "gains": {"kp_per_deg": 0.01, "ki_per_deg_s": 0.2}}
TUNED_AXES = ("error_deg", "error_x_deg", "error_y_deg")


def study(folder: Path, model: TwoAxisModel = ALONE, **changes: Any) -> dict[str, Any]:
    file = str(model.save(folder / "both.yaml"))
    plain = {
        "plant": {"simulator": file, "noise_deg": 0.05},
        "model": file,
        "motions": {"circle": CIRCLE},
        "controllers": {"pid": PID, "mpc": {"kind": "linearised_mpc"}},
    }
    return plain | changes


def sweep(folder: Path, **changes: Any) -> SweepSettings:
    data: dict[str, Any] = {"base": study(folder), "draw": {"plant.lag_s": {"uniform": [0.0, 0.1]}}, "count": 3}
    return with_base(SweepSettings.parse(data | changes), folder / "sweep.yaml")


def tuning(folder: Path, **changes: Any) -> TuneSettings:
    data: dict[str, Any] = {
        "base": study(folder, controllers={"pid": PID}),
        "draw": {
            "plant.lag_s": {"uniform": [0.0, 0.1]},
            'plant.y.mismatch."prandtl_ishlinskii.a1"': {"uniform": [1, 2]},
        },
        "plants": {"count": 2, "seed": 1},
        "held_out": {"count": 4, "seed": 2},
        "trials": 8,
    }
    return complete(TuneSettings.parse(data | changes), folder / "tune.yaml")


def figures(folder: Path) -> dict[str, tuple[str, ...]]:
    """What every row found, by id."""
    names = ("status", *result_columns(2))
    view = SweepView(table_of(folder, ["id", *names]), {})
    return dict(zip(view.texts("id"), zip(*(view.texts(name) for name in names), strict=True), strict=True))


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SweepOutcome]:
    """A sweep made in one go in this process."""
    folder = tmp_path_factory.mktemp("swept")
    return folder / "whole", run_sweep(sweep(folder), folder / "whole", InTurn())


def test_a_row_has_the_error_of_the_tip_then_those_of_x_and_y(swept: tuple[Path, SweepOutcome]) -> None:
    folder, outcome = swept
    assert (outcome.rows, outcome.failed) == (6, 0)
    with (folder / "runs.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = list(rows[0])
    assert names[names.index("rmse_deg") :][:3] == ["rmse_deg", "rmse_x_deg", "rmse_y_deg"]
    for row in rows:
        x, y = float(row["rmse_x_deg"]), float(row["rmse_y_deg"])
        assert float(row["rmse_deg"]) == pytest.approx(np.hypot(x, y))
        assert row["limit_violations"] == "0"
    page = outcome.report.read_text(encoding="utf-8")
    assert "x, median" in page
    assert "rmse_y_deg" in page


def test_a_sweep_that_was_interrupted_and_goes_on_gives_the_same_table(
    swept: tuple[Path, SweepOutcome], tmp_path: Path
) -> None:
    def interrupt(done: int, total: int, note: str) -> None:
        if done == 2:
            raise KeyboardInterrupt

    settings, folder = sweep(swept[0].parent), tmp_path / "sweep"
    with pytest.raises(KeyboardInterrupt):
        run_sweep(settings, folder, InTurn(), interrupt)
    assert len(figures(folder)) == 2
    assert run_sweep(settings, folder, InTurn()).kept == 2
    assert figures(folder) == figures(swept[0])


def test_a_row_can_be_made_again(swept: tuple[Path, SweepOutcome], tmp_path: Path) -> None:
    identity = next(iter(figures(swept[0])))
    again = reproduce(swept[0], identity, tmp_path / "run")
    assert [figure.name for figure in again] == list(result_columns(2))
    assert all(figure.equal for figure in again)
    rmse = next(figure.repeated for figure in again if figure.name == "rmse_deg")
    assert load_results(tmp_path / "run").results[0].metrics.rmse_deg == rmse


def test_a_path_into_a_controller_sets_that_key_alone(tmp_path: Path) -> None:
    """What is left out follows from what joins the axes, and must not become the default by a sweep."""
    path = "controllers.mpc.weights.terminal"
    settings = sweep(tmp_path, grid={path: [2.0]}, draw={}, count=1)
    rows = [row for row in SweepPlan(settings).rows() if row.controller == "mpc"]
    assert len(rows) == 1
    (controller,) = rows[0].config().controllers.values()
    assert controller.model_dump(exclude_unset=True) == {"kind": "linearised_mpc", "weights": {"terminal": 2.0}}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"grid": {"controllers.mpc.weights.terminl": [1.0]}}, "did you mean 'terminal'"),
        ({"grid": {"plant.z.mismatch": [{}]}}, "no key 'z'"),
        ({"grid": {"plant.x.effects": [[{"effect": "lagg"}]]}}, "lag"),
        ({"draw": {"plant.noise_deg": {"uniform": [-1.0, 0.1]}}}, "greater than or equal to 0"),
        ({"grid": {"tune_pid": [{"evaluations": 20}]}}, "tune_pid is for `simulate` alone"),
    ],
)
def test_wrong_paths_are_one_line(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    base = {"base": study(tmp_path), "count": 1}
    (tmp_path / "sweep.yaml").write_text(dump_yaml(base | changes))
    with pytest.raises(ConfigError, match=message) as refused:
        SweepPlan(load_sweep(tmp_path / "sweep.yaml"), tmp_path / "sweep.yaml").check()
    assert len(str(refused.value)) <= 300
    assert "\n" not in str(refused.value)


def test_the_gains_that_a_study_finds_lower_the_error_with_another_seed(tmp_path: Path) -> None:
    """Of the noise; the same gains make the run again, without the search."""
    given = study(tmp_path, controllers={"pid": PID}, seed=1)
    found = hystmpc.simulate(given | {"tune_pid": {"evaluations": 30}}, tmp_path / "run")
    config = read_yaml(tmp_path / "run" / "config.yaml")
    assert (config["tuned"], config["tune_pid"]) == (["pid"], None)
    again = hystmpc.simulate(tmp_path / "run" / "config.yaml").results[0]
    np.testing.assert_array_equal(again.run.true_deg, found.results[0].run.true_deg)
    tuned = hystmpc.simulate(tmp_path / "run" / "config.yaml", overrides=["seed=7"]).results[0]
    assert tuned.metrics.rmse_deg < 0.5 * hystmpc.simulate(given | {"seed": 7}).results[0].metrics.rmse_deg
    assert tuned.metrics.limit_violations == 0
    assert "Found by search" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Tuning]:
    """A short tuning made in one go in this process."""
    pytest.importorskip("optuna", reason="optuna is an extra")
    folder = tmp_path_factory.mktemp("tuned")
    return folder / "whole", run_tuning(tuning(folder), folder / "whole", InTurn())


def test_tuning_helps_on_plants_that_it_has_not_seen(tuned: tuple[Path, Tuning]) -> None:
    folder, done = tuned
    assert done.settings.with_values(dict(done.trials[0].values)) == done.settings.given
    assert done.check.gain > 0.1
    assert done.check.interval()[0] > 0.0
    controller = parse_controller(read_yaml(folder / "controller.yaml"))
    assert controller == done.settings.with_values(dict(done.best.values))
    both = hystmpc.simulate(folder / "study.yaml").results
    assert both[1].metrics.rmse_deg < both[0].metrics.rmse_deg
    header = (folder / "held_out.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert [name.removeprefix("tuned_") for name in header if name.startswith("tuned_error")] == list(TUNED_AXES)
    for row in done.check.rows():
        assert row[2] >= max(row[3], row[4])
    assert "mean error x [deg]" in (folder / "report.html").read_text(encoding="utf-8")


def test_a_tuning_goes_on_where_it_was_stopped(tuned: tuple[Path, Tuning], tmp_path: Path) -> None:
    seen: list[float] = []

    def interrupt(done: float, total: float, note: str) -> None:
        seen.append(done)
        if len(seen) == 3:
            raise KeyboardInterrupt

    settings = tuning(tuned[0].parent)
    with pytest.raises(KeyboardInterrupt):
        run_tuning(settings, tmp_path / "tune", InTurn(), progress=interrupt)
    done = run_tuning(settings, tmp_path / "tune", InTurn())
    assert [trial.values for trial in done.trials] == [trial.values for trial in tuned[1].trials]


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_every_kind_of_controller_has_a_space_whose_ends_can_be_built(kind: str, tmp_path: Path) -> None:
    base = study(tmp_path, JOINED, controllers={"c": {"kind": kind}})
    settings = tuning(tmp_path, base=base, draw={})
    assert settings.with_values(settings.given_values) == settings.given
    both = {"c": settings.with_values({path: one.ends[0] for path, one in settings.search.items()})}
    prepare_two_axes(settings.study.model_copy(update={"controllers": both}))  # type: ignore[arg-type]
    assert {path for path in settings.draw if "mismatch" in path} >= {
        f'plant.{axis}.mismatch."prandtl_ishlinskii.a1"' for axis in "xy"
    }


def test_the_need_of_a_motion_is_the_travel_of_the_inverse_where_the_plant_is_the_model(tmp_path: Path) -> None:
    data = study(tmp_path, controllers={"inverse": {"kind": "inverse"}})
    data["plant"]["noise_deg"] = 0.0
    result = hystmpc.simulate(data).results[0]
    ready = prepare_two_axes(TwoAxisSimulationConfig.parse(data, "study"))
    assert needed_travel(ready, "circle") == pytest.approx(result.metrics.command_travel, rel=0.05)


def test_margins_of_two_axes_are_refused_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(HystmpcError, match="margins: got a study of two axes, expected none") as refused:
        tuning(tmp_path, margins={})
    assert "\n" not in str(refused.value)

"""Closed loops of two axes: the plant is the model's run, folders are read back, settings of one axis are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hystmpc
from hystmpc.sim.results import load_results, tracking_metrics
from hystmpc.sim.two_axes.columns import apart, together
from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
from hystmpc.sim.two_axes.plant import TwoAxisPlant
from hystmpc.trials.errors import ConfigError, ControllerError, HystmpcError, ModelError, TrajectoryError

from ..models.two_axis_examples import RATE, SHARED, two_axes, wandering

JOINED = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)), SHARED)
PID = {"kind": "pid", "gains": {"kp_per_deg": 0.04, "ki_per_deg_s": 0.6}}
CONTROLLERS = {"pid": PID, "inverse": {"kind": "inverse"}, "mpc": {"kind": "linearised_mpc"}}


def plant_of(**changes: Any) -> TwoAxisPlant:
    return TwoAxisPlant(JOINED, TwoAxisPlantSettings(simulator="", **changes), seed=3)


@given(st.integers(0, 1000))
def test_the_plant_without_changes_is_the_free_run_of_its_model(seed: int) -> None:
    plant, commands = plant_of(virgin=True), wandering(seed, 150)
    start = plant.reset()
    angles = np.array([plant.apply(u) for u in commands])
    expected = JOINED.run(np.vstack([np.zeros(2), commands]), start)[1:]
    np.testing.assert_allclose(angles, expected, atol=1e-6)  # a lag of the plant has settled for twenty time constants


def test_a_reset_repeats_the_run_with_its_noise() -> None:
    plant, commands = plant_of(noise_deg=0.2, lag_s=0.1, delay_s=0.06, quantisation_deg=0.01), wandering(1, 60)
    runs = [np.array([plant.reset(), *(plant.apply(u) for u in commands)]) for _ in range(2)]
    np.testing.assert_array_equal(*runs)
    np.testing.assert_allclose(runs[0] / 0.01, np.round(runs[0] / 0.01), atol=1e-6)


def test_a_delay_holds_the_angles_back_by_whole_samples() -> None:
    commands = wandering(4, 80)
    at_once, late = plant_of(), plant_of(delay_s=2 * JOINED.dt_s)
    first = np.array([at_once.apply(u) for u in commands])
    second = np.array([late.apply(u) for u in commands])
    np.testing.assert_allclose(second[2:], first[:-2], atol=1e-9)


def test_a_mismatch_changes_its_axis_alone() -> None:
    aligned, commands = two_axes(), wandering(2, 80)
    settings = TwoAxisPlantSettings(simulator="", y={"mismatch": {"prandtl_ishlinskii.a1": 1.5}})  # type: ignore[arg-type]
    plants = [TwoAxisPlant(aligned, one) for one in (TwoAxisPlantSettings(simulator=""), settings)]
    runs = [np.array([plant.apply(u) for u in commands]) for plant in plants]
    np.testing.assert_array_equal(runs[0][:, 0], runs[1][:, 0])
    assert np.ptp(runs[0][:, 1] - runs[1][:, 1]) > 1.0


@given(st.integers(1, 20))
def test_columns_of_both_axes_are_put_together_again(count: int) -> None:
    columns = {
        "command_bar": np.arange(2.0 * count).reshape(-1, 2),
        "time_s": np.arange(count),
        "source": ("a",) * count,
    }
    columns["angle_deg"] = columns["held_before"] = -np.asarray(columns["command_bar"])
    split = apart(columns)
    assert {"command_x_bar", "angle_y_deg", "held_before_x", "time_s", "source"} <= set(split)
    again = together(split)
    assert set(again) == set(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(again[name], values)


def study(folder: Path, **changes: Any) -> dict[str, Any]:
    model = JOINED.save(folder / "both.yaml")
    star = {"kind": "star", "centre": [0, 0], "radius": 10, "hold_s": 0.6, "limits": {"velocity_deg_s": 25}}
    motions = {"star": star, "tip": {"kind": "spiral", "centre": [0, 0], "radius": 5, "period_s": 2, "length_mm": 60}}
    plant = {"simulator": str(model), "noise_deg": 0.05, "x": {"mismatch": {"prandtl_ishlinskii.a1": 1.1}}}
    return {"plant": plant, "model": str(model), "motions": motions, "controllers": CONTROLLERS, "seed": 1} | changes


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    folder = tmp_path_factory.mktemp("two")
    return folder / "run", hystmpc.simulate(study(folder), folder / "run")


def test_every_controller_tracks_within_the_limits_and_prediction_is_best(run: tuple[Path, Any]) -> None:
    _, result = run
    assert result.motions == ("star", "tip")
    for one in result.results:
        assert one.metrics.limit_violations == 0
        x, y = one.run.axis_rmse_deg
        assert one.metrics.rmse_deg == pytest.approx(np.hypot(x, y))
        assert one.metrics.max_abs_deg >= one.metrics.rmse_deg
    star = {one.controller: one.metrics.rmse_deg for one in result.of_motion("star")}
    assert star["mpc"] < 0.6 * star["pid"]
    assert star["mpc"] < 0.5
    assert "mpc tracks best" in (run[0] / "report.html").read_text()
    assert result.plot().axes


def test_a_command_beyond_its_limits_is_counted(run: tuple[Path, Any]) -> None:
    one = run[1].results[0]
    narrow = tuple(replace(limits, upper=0.5) for limits in one.limits)
    assert tracking_metrics(one.run, narrow).limit_violations == np.sum(
        np.any(one.run.log.command > 0.5 + 1e-8, axis=1)
    )


def test_a_folder_is_read_back_and_reported_again(run: tuple[Path, Any]) -> None:
    folder, result = run
    again = load_results(folder)
    for one, other in zip(result.results, again.results, strict=True):
        np.testing.assert_allclose(one.run.true_deg, other.run.true_deg)
        np.testing.assert_allclose(one.run.rest_command, other.run.rest_command)
        assert one.metrics.rmse_deg == pytest.approx(other.metrics.rmse_deg)
        assert one.limits == other.limits
    hystmpc.report(folder)
    (trial,) = hystmpc.read_trials(folder / "star" / "mpc" / "log.csv")
    assert {"command_y_mm", "angle_y_deg"} <= set(trial.channels)


def test_the_written_settings_make_the_run_again(run: tuple[Path, Any], tmp_path: Path) -> None:
    alone = run[0] / "star" / "mpc" / "config.yaml"
    again = hystmpc.simulate(alone, tmp_path / "again", overrides=["approach=true"])
    (first,) = (one for one in run[1].of_motion("star") if one.controller == "mpc")
    np.testing.assert_array_equal(again.results[0].run.true_deg, first.run.true_deg)


def test_where_the_device_is_the_model_prediction_is_nearly_exact(tmp_path: Path) -> None:
    given_ = study(tmp_path, controllers={"mpc": {"kind": "linearised_mpc"}})
    given_["plant"] = {"simulator": given_["model"]}
    del given_["motions"]["tip"]
    assert hystmpc.simulate(given_).results[0].metrics.rmse_deg < 0.2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sensor": {"kind": "none"}}, "got sensor and a model of two axes"),
        ({"tune_pid": {"evaluation": 3}}, "unknown key.*did you mean 'evaluations'"),
        ({"motions": {"scan": {"kind": "scan_sinusoid"}}}, "none of two axes"),
        (
            {"motions": {"c": {"kind": "circle", "centre": [0, 0], "radius": 9, "period_s": 2, "length_mm": 10}}},
            "reach",
        ),
        ({"motions": {"c": {"kind": "circle", "centre": [0], "radius": 9, "period_s": 2}}}, "centre"),
        ({"limits": {"lower": [-3], "upper": [3], "rate_per_s": [8]}}, "expected 2 of each"),
        ({"limits": {"lower": [-9, -9], "upper": [3, 3], "rate_per_s": [8, 8]}}, "beyond_model"),
        ({"controllers": {"a": {"kind": "nothing"}}}, "kind"),
        ({"model": "builtin:pi", "axes": 2}, "builtin:pi"),
    ],
)
def test_wrong_settings_are_one_line(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    with pytest.raises((ConfigError, ControllerError, ModelError, TrajectoryError), match=words) as refused:
        hystmpc.simulate(study(tmp_path) | change, tmp_path / "run")
    assert len(str(refused.value)) <= 300
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        ({"x": {"mismatch": {"nothing": 1.0}}}, "plant.x: mismatch"),
        ({"y": {"effects": [{"effect": "nothing"}]}}, "nothing"),
        ({"mismatch": {"x": 1.0}}, "unknown key"),
        ({"simulator": "nowhere.yaml"}, "nowhere.yaml"),
    ],
)
def test_wrong_plants_are_one_line(tmp_path: Path, plant: dict[str, Any], words: str) -> None:
    given_ = study(tmp_path)
    with pytest.raises(HystmpcError, match=words) as refused:
        hystmpc.simulate(given_ | {"plant": given_["plant"] | plant})
    assert len(str(refused.value)) <= 300


def test_tendons_are_refused_in_a_line(tmp_path: Path) -> None:
    four = JOINED.with_tendons([0, 90, 180, 270], pretension=1.0, limits=[(0.2, 4.0)] * 4, rates_per_s=[RATE] * 4)
    given_ = study(tmp_path)
    with pytest.raises(ConfigError, match="a model of 4 commands"):
        hystmpc.simulate(given_ | {"model": str(four.save(tmp_path / "four.yaml"))})

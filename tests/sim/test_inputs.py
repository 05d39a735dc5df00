"""Measured inputs of a simulated plant: constant or from a log, and seen by the controllers of the study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.models.simulator import save_simulator
from hystmpc.sim.config import PlantSettings, SimulationConfig, located
from hystmpc.sim.plants.device import make_plant
from hystmpc.sim.study import prepare
from hystmpc.trials.errors import ConfigError, LogError

from ..ctrl.test_inputs import CHAIN
from ..models.zoo import DT, simulator

MOTION = {
    "kind": "scan_sinusoid",
    "start_deg": 56.0,
    "centre_deg": 56.0,
    "amplitude_deg": 14.0,
    "frequency_hz": 0.2,
    "cycles": 3,
}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(save_simulator(simulator(CHAIN), tmp_path_factory.mktemp("model") / "m.yaml"))


def errors(model: str, inputs: Any, controller: str = "linearised_mpc", **more: Any) -> np.ndarray:
    settings = {
        "model": model,
        "plant": {"simulator": model, "inputs": inputs},
        "motions": {"sweep": MOTION},
        "controllers": {"c": {"kind": controller, **more}},
    }
    study = prepare(SimulationConfig.parse(settings))
    return study.run(study.config.controllers["c"], "sweep").counted_deg


def test_a_plant_without_values_has_the_identified_ones(model: str) -> None:
    plain, given = (make_plant(PlantSettings.parse({"simulator": model, "inputs": i})) for i in ({}, {"bar": 2.0}))
    commands = 3.0 - 2.0 * np.cos(0.2 * np.arange(60))
    np.testing.assert_array_equal(*([plant.apply(float(u)) for u in commands] for plant in (plain, given)))


def test_a_log_gives_the_input_over_time_and_a_reset_begins_again(model: str, tmp_path: Path) -> None:
    t = np.arange(0.0, 3.0, 0.05)
    rows = [f"{a:.2f},1.0,2.0,{1.0 + a:.3f}" for a in t]
    (tmp_path / "log.csv").write_text("time_s,command,angle_deg,bar\n" + "\n".join(rows) + "\n")
    settings = PlantSettings.parse({"simulator": model, "inputs": {"bar": {"log": str(tmp_path / "log.csv")}}})
    plant = make_plant(settings)
    seen, angles = [], []
    for k in range(150):
        seen.append(plant.inputs["bar"])  # type: ignore[attr-defined]
        angles.append(plant.apply(3.0 + np.sin(0.1 * k)))
    np.testing.assert_allclose(seen, np.minimum(1.0 + DT * np.arange(150), 3.95), atol=1e-9)
    plant.reset()
    assert [plant.apply(3.0 + np.sin(0.1 * k)) for k in range(150)] == angles


def test_a_wrong_input_is_one_line(model: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="does not depend on 'baar', available: bar"):
        make_plant(PlantSettings.parse({"simulator": model, "inputs": {"baar": 2.0}}))
    with pytest.raises(ConfigError, match="does not depend on 'bar'"):
        make_plant(PlantSettings.parse({"simulator": "builtin:pi", "inputs": {"bar": 2.0}}))
    with pytest.raises(ConfigError, match="expected one of `value: NUMBER`"):
        PlantSettings.parse({"simulator": model, "inputs": {"bar": {}}})
    with pytest.raises(ConfigError, match="expected none: a simulator has them"):
        PlantSettings.parse({"device": "tendon", "inputs": {"bar": 1.0}})
    (tmp_path / "log.csv").write_text("time_s,command,angle_deg\n" + "\n".join(f"{k / 25},1,2" for k in range(60)))
    with pytest.raises(LogError, match="no input 'bar'"):
        make_plant(PlantSettings.parse({"simulator": model, "inputs": {"bar": {"log": str(tmp_path / "log.csv")}}}))


def test_relative_files_start_at_the_folder_of_the_study(model: str, tmp_path: Path) -> None:
    plant = {"simulator": model, "inputs": {"bar": {"log": "a.csv", "layout": "map.yaml"}, "other": 1.0}}
    config = SimulationConfig.parse(
        {"model": model, "plant": plant, "motions": {"m": MOTION}, "controllers": {"c": {"kind": "inverse"}}}
    )
    placed = located(config, tmp_path).plant.inputs
    assert placed["bar"].log == str(tmp_path / "a.csv")
    assert placed["bar"].layout == str(tmp_path / "map.yaml")
    assert placed["other"].value == 1.0


@pytest.mark.parametrize("controller", ["linearised_mpc", "inverse_pid"])
def test_the_controllers_of_a_study_measure_the_plants_inputs(model: str, controller: str) -> None:
    more = {"adaptation": None} if controller == "linearised_mpc" else {}
    away = errors(model, {"bar": 4.0}, controller, **more)
    assert np.sqrt(np.mean(away**2)) < 0.2  # the friction is twice that of the identified value

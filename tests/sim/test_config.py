"""A wrong study is answered in one line that names the key, what was got and what there is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hystmpc.models.load import library_file, library_names, load_model, model_path
from hystmpc.sim.compare import demo_config
from hystmpc.sim.config import SimulationConfig, load_simulation
from hystmpc.sim.study import prepare
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError, ControllerError, HystmpcError, ModelError

from .small import MOVE, study, study_data

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plnat": {}}, r"unknown key 'plnat'.*did you mean 'plant'"),
        ({"plant": {"simulator": "x.yaml", "lag": 0.1}}, r"plant.*unknown key 'lag'.*did you mean 'lag_s'"),
        ({"plant": {"simulator": "x.yaml", "lag_s": -1}}, r"plant\.lag_s.*greater than or equal to 0.*-1"),
        ({"controllers": {"a": {"kind": "mpc"}}}, r"controllers\.a.*unknown kind 'mpc'.*linearised_mpc"),
        ({"controllers": {"a": {}}}, r"controllers\.a.*got neither kind nor python.*inverse"),
        ({"controllers": {"a b": {"kind": "pid"}}}, r"controllers\.a b.*pattern"),
        ({"controllers": {}}, r"controllers.*at least 1"),
        ({"motions": {"m": {"kind": "walk"}}}, r"motions\.m.*unknown kind 'walk'"),
        ({"motions": {"../m": MOVE}}, r"motions.*pattern"),
        ({"limits": {"lower": 2, "upper": 1, "rate_per_s": 1}}, r"limits.*lower < upper"),
    ],
)
def test_wrong_settings(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        SimulationConfig.parse(study_data(**changes))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"model": "builtin:lsmt"}, ModelError, "'lsmt', available: .*did you mean 'lstm'"),
        ({"plant": {"simulator": "nowhere.yaml"}}, ModelError, r"nowhere\.yaml: cannot be read"),
        ({"plant": {"simulator": "builtin:pi", "mismatch": {"lag.tau": 2}}}, ConfigError, r"mismatch.*'lag\.tau'"),
        (
            {"controllers": {"pid": {"kind": "pid", "limits": {"lower": -1, "upper": 6, "rate_per_s": 1}}}},
            ControllerError,
            r"controllers\.pid: limits: got -1",
        ),
        (
            {"controllers": {"pid": {"kind": "pid", "limits": {"lower": 1, "upper": 6, "rate_per_s": 1}}}},
            ControllerError,
            r"controllers\.pid: .*start at",
        ),
    ],
)
def test_what_cannot_be_prepared(changes: dict[str, Any], kind: type[HystmpcError], message: str) -> None:
    with pytest.raises(kind, match=message):
        prepare(study(**changes))


def test_relative_files_start_at_the_folder_of_the_settings(tmp_path: Path) -> None:
    (tmp_path / "motion.csv").write_text("time_s,angle_deg\n0,29\n1,40\n")
    motions = {"recorded": {"kind": "sampled", "file": "motion.csv"}}
    plant = {"simulator": "../device.yaml"}
    file = tmp_path / "below" / "study.yaml"
    file.parent.mkdir()
    file.write_text(dump_yaml(study_data(plant=plant, motions=motions, inverse="own.yaml")))
    config = load_simulation(file, ["plant.lag_s=0.1", "motions.recorded.file=../motion.csv"])
    assert Path(config.plant.simulator).resolve() == tmp_path / "device.yaml"
    assert config.inverse == str(file.parent / "own.yaml")
    assert config.model == "builtin:pi"
    assert config.plant.lag_s == 0.1
    assert config.motions["recorded"].build().duration_s == 1.0


EFFECT_STUDY = """\
plant:
  simulator: builtin:tendon-catheter
  effects:
    - effect: creep
      side: command
      parameters: {share: 0.2, tau_s: 6.0}
    - effect: sensor
      seed: 3
      parameters:
        resolution: 0.1
        sigma: 0.05
model: builtin:pi
motions:
  move: {kind: point_to_point, start_deg: 29, targets_deg: [40], holds_s: [0.8], limits: {velocity_deg_s: 40}}
controllers:
  pid: {kind: pid}
"""


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("effect: creep", "effect: crep", r"line 4: plant\.effects\.0: no effect 'crep'.*did you mean 'creep'"),
        ("side: command", "side: comand", r"line 5: .*side 'comand'.*did you mean 'command'"),
        ("tau_s: 6.0", "tau_ms: 6000", r"line 6: .*no parameter 'tau_ms'.*did you mean 'tau_s' in s"),
        ("tau_s: 6.0", "tau: 6", r"line 6: .*no parameter 'tau'.*did you mean 'tau_s' in s"),
        ("share: 0.2", "share: 1.2", r"line 6: .*creep\.share is 1\.2, expected -3 to 0\.95"),
        ("sigma: 0.05", "sigma: -0.05", r"line 11: .*sensor\.sigma is -0\.05 deg, expected 0 to 1000 deg"),
        ("sigma: 0.05", "sigma: low", r"line 11: .*valid number.*'low'"),
        ("resolution: 0.1", "resolutoin: 0.1", r"line 10: .*did you mean 'resolution'"),
        ("seed: 3", "sed: 3", r"line 8: .*unknown key 'sed'.*did you mean 'seed'"),
        ("model: builtin:pi", "modle: builtin:pi", r"line 12: .*unknown key 'modle'.*did you mean 'model'"),
        ("kind: pid", "kind: pdi", r"line 16: controllers\.pid: unknown kind 'pdi'.*did you mean 'pid'"),
    ],
)
def test_a_wrong_entry_is_named_with_its_line(tmp_path: Path, right: str, wrong: str, message: str) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(EFFECT_STUDY)
    kept = load_simulation(file)
    assert [e.effect for e in kept.plant.effects] == ["creep", "sensor"]
    assert SimulationConfig.parse(kept.model_dump(mode="json")) == kept
    assert right in EFFECT_STUDY
    file.write_text(EFFECT_STUDY.replace(right, wrong))
    with pytest.raises(ConfigError, match=rf"study\.yaml, {message}") as error:
        load_simulation(file)
    assert "\n" not in str(error.value)


def test_effects_reach_the_plant(tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(EFFECT_STUDY)
    plant = prepare(load_simulation(file)).plant
    assert "creep.share" in plant.simulator.chain.labels
    assert plant.reset() != plant.true_angle


def test_settings_of_a_run_are_settings_again() -> None:
    config = demo_config()
    assert SimulationConfig.parse(config.model_dump(mode="json")) == config


@pytest.mark.parametrize("name", library_names())
def test_every_model_that_ships_opens(name: str) -> None:
    assert load_model(library_file(name)).metadata.command_unit == "mm"


def test_a_path_is_no_built_in_name() -> None:
    assert model_path("lstm.onnx", "there") == Path("there/lstm.onnx")
    assert model_path("builtin:lstm", "there") == library_file("lstm")


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("simulate*.yaml")), ids=lambda file: file.name)
def test_examples_are_valid(file: Path) -> None:
    config = load_simulation(file)
    assert {s.kind for s in config.controllers.values()} >= {"inverse", "pid", "linearised_mpc", "sampling_mpc"}
    for motion in config.motions.values():
        assert motion.build().duration_s > 0

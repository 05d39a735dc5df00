"""Plants by name: the devices stand wherever a simulator file can, with effects, and keep a plant's promises."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.bench.device import make_plant as bench_plant
from hystmpc.models.contract.metadata import Range
from hystmpc.sim.config import PlantSettings, SimulationConfig, load_simulation
from hystmpc.sim.devices.names import DEVICES, named_device, parameter_lines
from hystmpc.sim.plants.computed import ComputedPlant
from hystmpc.sim.plants.device import make_plant
from hystmpc.sim.study import prepare
from hystmpc.sim.sweep.plan import SweepPlan, run_row
from hystmpc.sim.sweep.settings import SweepSettings
from hystmpc.sim.tuning.settings import default_draws
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError

from ..refusals import names
from .small import study_data

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
ROD: dict[str, Any] = {"device": "rod", "noise_deg": 0.1, "lag_s": 0.05}
CREEP = {"effect": "creep", "side": "command", "parameters": {"share": 0.2, "tau_s": 1.0}}
STOP = {"effect": "contact", "side": "output", "parameters": {"angle": 55.0, "stiffness_ratio": 0.0}}
BEATING = {"effect": "periodic_disturbance", "parameters": {"frequency_hz": 1.0, "amplitude": 0.5}}
SHOWN = {"effect": "sensor", "parameters": {"sigma": 0.1, "resolution": 0.05}}
ALL: dict[str, dict[str, Any]] = {
    "file": {"simulator": "builtin:tendon-catheter", "noise_deg": 0.1},
    **{name: {"device": name, "noise_deg": 0.1} for name in DEVICES},
    "rod with effects": {**ROD, "effects": [CREEP, STOP, BEATING, SHOWN]},
}
commands = st.lists(st.floats(0.0, 3.0), min_size=1, max_size=15)


def plant(seed: int = 0, **block: Any) -> ComputedPlant:
    return make_plant(PlantSettings.parse(block), 0.04, seed=seed)


def seen(device: ComputedPlant, wanted: Iterable[float]) -> list[tuple[float, float]]:
    return [(device.apply(float(u)), device.true_angle) for u in wanted]


PLANTS: Mapping[str, ComputedPlant] = {name: plant(**block) for name, block in ALL.items()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
@given(u=commands)
@settings(max_examples=5)
def test_a_reset_finds_the_same_device_and_another_seed_another(name: str, u: list[float]) -> None:
    device, equal = PLANTS[name], plant(**ALL[name])
    first = [device.reset(), seen(device, u)]
    assert [device.reset(), seen(device, u)] == first
    assert [equal.reset(), seen(equal, u)] == first
    assert device.reseeded(1).reset() != first[0]


@pytest.mark.parametrize("name", ALL)
@given(before=commands, after=commands, other=commands)
@settings(max_examples=5)
def test_a_copy_has_the_same_future_and_is_apart(
    name: str, before: list[float], after: list[float], other: list[float]
) -> None:
    device = PLANTS[name]
    device.reset()
    seen(device, before)
    kept = device.copied()
    first = seen(device, after)
    again = kept.copied()
    seen(device, other)
    assert seen(kept, after) == first
    assert seen(again, after) == first


def test_a_device_without_effects_is_the_device_alone() -> None:
    u = np.linspace(0, 4, 40)
    plain = seen(plant(device="rod"), u)
    # None that lengthens the rest before the run: the rod relaxes in it.
    neutral = [{"effect": name} for name in ("drift",)]
    np.testing.assert_allclose(seen(plant(device="rod", effects=neutral), u), plain, atol=1e-9)


def test_effects_act_on_their_side() -> None:
    u = np.concatenate([np.linspace(0, 5, 60), np.full(10, 5.0)])
    plain, stopped = (np.array(seen(plant(device="rod", effects=e), u))[:, 1] for e in ([], [STOP]))
    np.testing.assert_allclose(stopped, np.minimum(plain, 55.0), atol=1e-9)
    late = np.array(seen(plant(device="rod", delay_s=0.12), u))[:, 1]
    np.testing.assert_allclose(late[3:], plain[:-3], atol=0.01)  # three samples more of rest
    beats = np.array(seen(plant(device="rod", effects=[BEATING]), u))[:, 1]
    t = 0.04 * np.arange(1, u.size + 1)
    np.testing.assert_allclose(beats - plain, 0.5 * np.sin(2 * np.pi * t), atol=1e-9)


def test_a_virgin_device_has_its_first_flexure_to_come() -> None:
    there_and_back = np.concatenate([np.linspace(0, 5, 100), np.linspace(5, 0, 100), np.zeros(50)])
    for name in ("rod", "tendon"):
        fresh, flexed = plant(device=name, virgin=True), plant(device=name)
        before = fresh.true_angle
        seen(fresh, there_and_back)
        seen(flexed, there_and_back)
        assert fresh.true_angle > before + 5
        assert fresh.true_angle == pytest.approx(flexed.true_angle, abs=2.0)


def test_parameters_and_factors_reach_the_device() -> None:
    u = np.linspace(0, 4, 40)
    plain = seen(plant(device="rod"), u)
    given = seen(plant(device="rod", parameters={"stiffness_nmm": 6.8951 * 2, "segments": 4}), u)
    assert given[-1][1] < plain[-1][1] - 3
    factor = {"stiffness_nmm": 2.0}
    assert seen(plant(device="rod", parameters={"segments": 4}, mismatch=factor), u) == given


def test_a_device_of_the_laboratory_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The line says what to install; a name that nobody has gets the nearest right one."""
    monkeypatch.setattr("hystmpc.sim.devices.names.DEVICES", {"tendon": DEVICES["tendon"]})
    with pytest.raises(ConfigError, match=r"no device 'rod', a part of the laboratory: pip install 'hystmpc\[pa"):
        named_device("rod", {}, {})
    with pytest.raises(ConfigError, match=r"no device 'tedon', .*tendon"):
        named_device("tedon", {}, {})


@pytest.mark.parametrize(
    ("block", "line", "message"),
    [
        ({"device": "rood"}, 2, "no device 'rood', available: muscle, rod, tendon; did you mean 'rod'?"),
        ({"device": "rod", "parameters": {"frictoin": 0.1}}, 4, "did you mean 'friction'"),
        ({"device": "rod", "parameters": {"rest_rad": 0.1}}, 4, "did you mean 'rest_deg'"),
        ({"device": "rod", "parameters": {"friction": 0.9}}, 4, "rod.friction is 0.9, expected 0 to 0.6"),
        ({"device": "rod", "parameters": {"travel_mm": -1}}, 4, "rod.travel_mm is -1 mm, expected 0.1 to 100 mm"),
        ({"device": "rod", "parameters": {"segments": 2.5}}, 4, "rod.segments: got 2.5, expected a whole number"),
        ({"device": "rod", "mismatch": {"segments": 2}}, 4, "expected a whole number, no factor"),
        ({"device": "rod", "mismatch": {"friction": 20}}, 4, "rod.friction is 1, expected 0 to 0.6"),
        ({"device": "rod", "parameters": {"weight_n": 50}}, 3, "expected at most"),
        ({"device": "rod", "parameters": {"friction": "much"}}, 4, "got 'much'"),
        ({"device": "tendon", "parameters": {"unloading_deg": 22}}, 3, "the lines cross"),
        ({"device": "rod", "simulator": "builtin:pi"}, 1, "got both of simulator and device, expected one"),
        ({"noise_deg": 0.1}, 1, "got none of simulator and device, expected one"),
        ({"simulator": "builtin:pi", "parameters": {"a": 1}}, 3, "got a for a simulator, expected none"),
        ({"device": "rod", "effects": [{"effect": "crep"}]}, 4, "did you mean 'creep'"),
    ],
)
def test_a_wrong_device_is_told_with_its_line(tmp_path: Path, block: dict[str, Any], line: int, message: str) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(dump_yaml(study_data(plant=block)), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_simulation(file)
    assert message in str(caught.value)
    assert names(str(caught.value), file, f", line {line}: plant")
    assert "\n" not in str(caught.value)


def test_limits_beyond_what_the_device_takes() -> None:
    config = SimulationConfig.parse(study_data(plant={"device": "rod", "parameters": {"travel_mm": 4}}))
    with pytest.raises(ConfigError, match="limits: got 0 to 6 mm, expected within 0 to 4 mm, what the device takes"):
        prepare(config)
    with pytest.raises(ConfigError, match="plant device muscle takes bar and model builtin:pi mm, expected one unit"):
        prepare(SimulationConfig.parse(study_data(plant={"device": "muscle", "parameters": {"greatest_bar": 6}})))
    rest = make_plant(PlantSettings.parse({"device": "rod"}), 0.04, Range(lower=1.0, upper=5.0))
    assert rest.rest_command == 1.0


def test_the_same_name_at_the_bench(tmp_path: Path) -> None:
    settings_: dict[str, Any] = {**ROD, "parameters": {"friction": 0.1}, "effects": [CREEP]}
    device, held = bench_plant(settings_, 0.04, 3, tmp_path, "mm")
    ours = plant(seed=3, **settings_)
    assert held == 0.0
    assert [device.reset(), *(device.apply(u) for u in (1.0, 2.0))] == [ours.reset(), ours.apply(1.0), ours.apply(2.0)]
    with pytest.raises(ConfigError, match="did you mean 'rod'"):
        bench_plant({"device": "rd"}, 0.04, 0, tmp_path, "mm")
    with pytest.raises(ConfigError, match="commands in bar, expected command_unit mm"):
        bench_plant({"device": "muscle"}, 0.04, 0, tmp_path, "mm")


def sweep(**changes: Any) -> SweepSettings:
    base = study_data(plant=ROD, controllers={"pid": {"kind": "pid"}})
    return SweepSettings.parse({"base": SimulationConfig.parse(base).model_dump(mode="json")} | changes)


def test_a_sweep_over_plants_and_their_numbers() -> None:
    plants = {"file": {"simulator": "builtin:tendon-catheter"}, "rod": {"device": "rod"}}
    draw = {"plant.parameters.friction": {"uniform": [0.0, 0.3]}}
    rows = [*SweepPlan(sweep(grid={"plant": plants})).rows(), *SweepPlan(sweep(draw=draw, count=2)).rows()]
    assert len({row.id for row in rows}) == 4
    assert len({row.files for row in rows}) == 4  # all numbers of a device count, those not in the settings too
    with pytest.raises(ConfigError, match=r"plant\.parameters\.frict.*did you mean 'friction'"):
        SweepPlan(sweep(draw={"plant.parameters.frict": {"uniform": [0.0, 0.3]}})).check()


def test_what_a_block_leaves_out_can_be_drawn() -> None:
    plants = {"rod": {"device": "rod"}, "slow": {"device": "rod", "lag_s": 0.1}}
    draw = {"plant.parameters.friction": {"uniform": [0.0, 0.3]}}
    assert SweepPlan(sweep(grid={"plant": plants}, draw=draw, count=2)).check() == 4


def test_the_example_is_right() -> None:
    study = load_simulation(EXAMPLES / "rod.yaml")
    assert study.plant.device == "rod"
    assert prepare(study).plant.rest_command == 0.0


@pytest.mark.slow
def test_a_row_on_the_rod_is_repeatable_to_the_last_bit() -> None:
    (row,) = SweepPlan(sweep()).rows()
    first, again = run_row(row), run_row(row)
    assert first["status"] == "done", first["message"]
    assert first["rmse_deg"] == again["rmse_deg"]
    assert first["limit_violations"] == 0


@pytest.mark.parametrize("name", DEVICES)
def test_a_tuning_that_is_told_nothing_draws_what_a_device_can_be(name: str) -> None:
    block = PlantSettings.parse({"device": name})
    factors = [path for path in default_draws(block) if "mismatch" in path]
    assert len(factors) >= 3
    for end in (0, 1):
        drawn = {path.split('"')[1]: default_draws(block)[path].ends[end] for path in factors}
        PlantSettings.parse({"device": name, "mismatch": drawn})


@pytest.mark.parametrize("name", DEVICES)
def test_parameters_in_words(name: str) -> None:
    assert any("friction [1]" in line for line in parameter_lines(name))


@pytest.mark.slow
@given(before=st.lists(st.floats(-1, 1, width=32), max_size=10), after=st.lists(st.floats(-1, 1, width=32), min_size=1))
@settings(max_examples=5)
def test_the_environment_on_the_rod(before: list[float], after: list[float]) -> None:
    gym_ = pytest.importorskip("hystmpc.sim.gym_", reason="gymnasium is an extra")
    env = gym_.HysteresisEnv.from_config(SimulationConfig.parse(study_data(plant={**ROD, "effects": [CREEP, SHOWN]})))
    env.reset(seed=1)

    def played(actions: list[float]) -> list[Any]:
        return [env.step(np.array([a], dtype=np.float32))[:2] for a in actions]

    played(before)
    state = env.get_state()
    first = [(o.tolist(), r) for o, r in played(after)]
    env.reset()
    env.set_state(state)
    assert [(o.tolist(), r) for o, r in played(after)] == first

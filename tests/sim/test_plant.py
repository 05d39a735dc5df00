"""What the simulated device promises: laws of lag, delay and noise, and the same device after every reset."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.chain import Chain
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.operators.dynamics import Delay
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.operators.measurement import Sensor
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.operators.slow_changes import Drift
from hystmpc.models.simulator import ChainModel, Simulator
from hystmpc.sim.plants.simulated import Effects, SimulatedPlant, mismatched
from hystmpc.trials.errors import ConfigError, ModelError

from .small import catheter

COMMANDS = np.concatenate([np.linspace(0, 5, 60), np.linspace(5, 2, 40), np.full(20, 2.0), np.linspace(2, 4, 30)])


def straight(before: tuple[Delay, ...] = ()) -> Simulator:
    """The catheter's file around a straight line of 10 deg/mm: what is left is the effects."""
    return replace(catheter(), chain=Chain(PrandtlIshlinskii(10.0, (0.0,), 0.1, 0.0, 30.0), before))


def run(plant: SimulatedPlant, commands: np.ndarray = COMMANDS) -> np.ndarray:
    """True angles after each command, from a reset."""
    plant.reset()
    angles = []
    for u in commands:
        plant.apply(float(u))
        angles.append(plant.true_angle)
    return np.array(angles)


def test_without_effects_it_is_the_simulator() -> None:
    plant, model = SimulatedPlant(catheter()), ChainModel(catheter())
    # The unloading branch after the flexure: every play at its own threshold.
    core = catheter().chain.core
    assert isinstance(core, PrandtlIshlinskii)
    state = np.array([[0.0, *(core.alpha * i for i in range(1, core.plays + 1))]])
    expected = []
    for u in COMMANDS:
        theta, state = model.advance(state, np.array([[u]]))
        expected.append(theta[0, 0])
    np.testing.assert_allclose(run(plant), expected, atol=1e-9)


def test_rest_is_the_unloading_line_of_a_backlash() -> None:
    line = Backlash(10.0, 11.0, 2.9, 2.0)
    plant = SimulatedPlant(replace(catheter(), chain=Chain(line)))
    assert plant.reset() == pytest.approx(line.m_lo * line.c_lo)
    assert plant.rest_command == 0.0


def test_lag_reaches_63_percent_of_a_step_after_its_time_constant() -> None:
    plant = SimulatedPlant(straight(), Effects(lag_s=0.2), dt_s=0.01)
    angles = run(plant, np.full(60, 3.0))
    assert angles[19] - 30.0 == pytest.approx(30.0 * (1 - math.exp(-1)), rel=1e-9)


@pytest.mark.parametrize("samples", [1, 3])
def test_whole_delay_shifts(samples: int) -> None:
    plain = run(SimulatedPlant(catheter()))
    late = run(SimulatedPlant(catheter(), Effects(delay_s=samples * 0.04)))
    np.testing.assert_allclose(late[samples:], plain[:-samples], atol=1e-9)
    np.testing.assert_allclose(late[:samples], SimulatedPlant(catheter()).true_angle, atol=1e-9)


def test_part_of_a_sample_of_delay_lies_between() -> None:
    half = run(SimulatedPlant(straight(), Effects(delay_s=0.02)))
    whole = run(SimulatedPlant(straight()))
    np.testing.assert_allclose(half[1:], 0.5 * (whole[1:] + whole[:-1]), atol=1e-9)


def test_delay_of_the_simulator_itself_keeps_its_length_at_another_sample_time() -> None:
    coarse = SimulatedPlant(straight((Delay.at_rate(0.08, 0.04),)))
    fine = SimulatedPlant(straight((Delay.at_rate(0.08, 0.04),)), dt_s=0.01)
    np.testing.assert_allclose(run(fine, np.repeat(COMMANDS, 4))[3::4], run(coarse), atol=1e-9)


def test_play_does_not_know_the_sample_time() -> None:
    core = catheter().chain.core
    assert isinstance(core, PrandtlIshlinskii)
    still = replace(catheter(), chain=Chain(replace(core, beta=0.0)))
    fine = run(SimulatedPlant(still, dt_s=0.01), np.repeat(COMMANDS, 4))
    np.testing.assert_allclose(fine[3::4], run(SimulatedPlant(still)), atol=1e-9)


def test_equal_seeds_give_equal_noise_after_every_reset() -> None:
    effects = Effects(noise_deg=0.15)
    plant = SimulatedPlant(catheter(), effects, seed=7)
    first = [plant.reset(), *(plant.apply(1.0) for _ in range(20))]
    assert first == [plant.reset(), *(plant.apply(1.0) for _ in range(20))]
    other = SimulatedPlant(catheter(), effects, seed=8)
    assert first != [other.reset(), *(other.apply(1.0) for _ in range(20))]


def test_reseeded_plant_is_the_same_device_with_other_noise() -> None:
    plant = SimulatedPlant(catheter(), Effects(lag_s=0.1, noise_deg=0.15), seed=7)
    other = plant.reseeded(8)
    measured = plant.reset()
    assert other.reset() != measured
    assert plant.reset() == measured
    np.testing.assert_array_equal(run(other), run(plant))


def test_noise_has_the_given_deviation_and_leaves_the_true_angle_alone() -> None:
    quiet, noisy = SimulatedPlant(catheter()), SimulatedPlant(catheter(), Effects(noise_deg=0.15), seed=3)
    noisy.reset()
    measured = np.array([noisy.apply(2.0) - noisy.true_angle for _ in range(4000)])
    assert np.std(measured) == pytest.approx(0.15, rel=0.05)
    assert abs(np.mean(measured)) < 0.01
    np.testing.assert_array_equal(run(noisy), run(quiet))


@given(u=st.floats(0.0, 6.0), step=st.floats(0.01, 2.0))
def test_quantised_angles_are_whole_steps_and_within_half_a_step(u: float, step: float) -> None:
    plant = SimulatedPlant(catheter(), Effects(quantisation_deg=step))
    measured = plant.apply(u)
    assert measured / step == pytest.approx(round(measured / step), abs=1e-6)
    assert abs(measured - plant.true_angle) <= 0.5 * step + 1e-9


def test_mismatch_multiplies_what_it_names_and_nothing_else() -> None:
    chain = catheter().chain
    changed = mismatched(chain, {"prandtl_ishlinskii.a0": 1.2})
    expected = chain.values.copy()
    expected[0] *= 1.2
    np.testing.assert_allclose(changed.values, expected)


def test_mismatch_of_an_unknown_parameter_is_answered_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"prandtl_ishlinskii\.a9.*available.*did you mean"):
        SimulatedPlant(catheter(), Effects(mismatch={"prandtl_ishlinskii.a9": 1.1}))


def test_mismatch_out_of_bounds_is_refused() -> None:
    with pytest.raises(ModelError, match=r"prandtl_ishlinskii\.a1 is -2"):
        SimulatedPlant(catheter(), Effects(mismatch={"prandtl_ishlinskii.a1": -1.0}))


@pytest.mark.parametrize("name", ["lag_s", "delay_s", "noise_deg", "quantisation_deg"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_effects_are_finite_and_not_negative(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=name):
        Effects(**{name: value})


def plant_with(*specs: dict[str, object], seed: int = 0, **others: object) -> SimulatedPlant:
    """The straight catheter with effects of the library."""
    return SimulatedPlant(straight(), Effects(effects=specs, **others), seed=seed)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_runs_in_a_plant_and_a_reset_finds_the_same_device(name: str) -> None:
    plant = plant_with({"effect": name, "parameters": dict(EFFECTS[name].shown[0])}, seed=4)
    first = [plant.reset(), *(plant.apply(float(u)) for u in COMMANDS)]
    assert first == [plant.reset(), *(plant.apply(float(u)) for u in COMMANDS)]
    assert np.all(np.isfinite(first))
    straight_line = np.array([30.0, *(30.0 + 10.0 * COMMANDS)])
    assert np.max(np.abs(np.array(first) - straight_line)) > 0.5


def test_library_and_shorthand_are_one_lag_and_one_delay() -> None:
    listed = plant_with(
        {"effect": "delay", "side": "command", "parameters": {"delay_s": 0.1}},
        {"effect": "lag", "side": "command", "parameters": {"tau_s": 0.2}},
    )
    short = SimulatedPlant(straight(), Effects(lag_s=0.2, delay_s=0.1))
    np.testing.assert_allclose(run(listed), run(short), atol=1e-9)


def test_a_sensor_shows_and_does_not_change() -> None:
    spec = {"effect": "sensor", "parameters": {"resolution": 0.5, "sigma": 0.2}}
    plant = plant_with(spec, seed=2)
    np.testing.assert_array_equal(run(plant), run(plant_with()))
    plant.reset()
    shown = np.array([plant.apply(2.0) for _ in range(300)])
    np.testing.assert_allclose(shown / 0.5, np.round(shown / 0.5), atol=1e-9)
    assert np.unique(shown).size > 2
    assert plant.true_angle == pytest.approx(50.0)
    again = plant.reseeded(3)
    again.reset()
    assert [again.apply(2.0) for _ in range(300)] != list(shown)


def test_a_sensor_of_the_simulator_file_shows_and_does_not_change() -> None:
    device = straight()
    noisy = replace(device, chain=replace(device.chain, after=(Sensor(0.0, 1.0, 0.0, 0.0, 0.0),)))
    plant = SimulatedPlant(noisy)
    np.testing.assert_array_equal(run(plant), run(SimulatedPlant(device)))
    assert plant.reset() != plant.true_angle


def test_a_first_flexure_has_been_taken_unless_the_device_is_virgin() -> None:
    spec = {"effect": "first_flexure", "side": "output", "parameters": {"set": 0.2, "threshold": 50.0}}
    once = np.concatenate([np.linspace(0, 6, 60), np.linspace(6, 0, 60)])
    top = 30.0 + 10.0 * 6.0
    bent = run(plant_with(spec), once)
    np.testing.assert_allclose(bent, 30.0 + 10.0 * once + 0.2 * (top - 50.0), atol=1e-9)
    virgin = run(plant_with(spec, virgin=True), once)
    assert virgin[0] == pytest.approx(30.0)
    np.testing.assert_allclose(virgin[60:], bent[60:], atol=1e-9)


def test_creep_has_settled_before_a_run() -> None:
    spec = {"effect": "creep", "side": "command", "parameters": {"share": 0.3, "tau_s": 8.0}}
    angles = run(plant_with(spec), np.zeros(100))
    np.testing.assert_allclose(angles, 30.0, atol=1e-6)


def test_clocks_start_with_the_run() -> None:
    drift = {"effect": "drift", "side": "output", "parameters": {"offset_per_min": 6.0}}
    heart = {"effect": "periodic_disturbance", "side": "output", "parameters": {"frequency_hz": 0.5, "amplitude": 1.0}}
    plant = plant_with(drift, heart)
    assert plant.reset() == pytest.approx(30.0)
    t = 0.04 * np.arange(1, 101)
    np.testing.assert_allclose(run(plant, np.zeros(100)), 30.0 + 0.1 * t + np.sin(np.pi * t), atol=1e-9)
    assert any(isinstance(operator, Drift) for operator in plant.simulator.chain.after)


def test_an_unknown_effect_is_refused_with_its_place_in_the_list() -> None:
    with pytest.raises(ConfigError, match=r"plant\.effects\[1\]: no effect 'crep'.*did you mean 'creep'"):
        plant_with({"effect": "drift"}, {"effect": "crep"})

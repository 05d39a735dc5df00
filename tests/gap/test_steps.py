"""Steps of the readings are named with their size; a sensor without any is not, whatever its noise."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.diagnosis import Diagnosis
from hystmpc.gap.logs.preparation import prepare
from hystmpc.gap.report.words import headline
from hystmpc.gap.self_test import CASES, record
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.identify.simulators import identify
from hystmpc.models.operators.measurement import Sensor
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial


def recorded(step: float, sigma: float, seed: int) -> list[Trial]:
    return record(replace(CASES["none"], sensor=Sensor(step, sigma, 0.0, 0.0, 0.0)), seed)


def identified(sigma: float) -> Simulator:
    return identify("backlash", recorded(0.0, sigma, 1001))[0]


def diagnosed(step: float, before: float, after: float) -> Diagnosis:
    """Of a device whose sensor has this noise, the simulator being identified with less noise and without steps."""
    return conclude(find_causes(recorded(step, after, 1), identified(before), seed=1))[0]


@pytest.mark.slow
@pytest.mark.parametrize(("step", "share"), [(0.3, 0.4), (2.0, 0.0), (5.0, 0.1)])
def test_steps_are_named_with_their_size(step: float, share: float) -> None:
    found = diagnosed(step, share * step, share * step)
    assert (found.verdict, [effect.name for effect in found.effects]) == ("named", ["sensor"])
    assert found.effects[0].parameters["resolution_deg"] == pytest.approx(step, rel=1e-2)
    assert f"steps of {step:.3g} deg" in found.reason
    assert f"steps of {step:.3g} deg" in headline(found)


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.3, 2.0])
def test_noise_of_the_same_size_is_not(step: float) -> None:
    sigma = step / 12.0**0.5
    found = diagnosed(0.0, sigma, sigma)
    assert (found.verdict, found.effects) == ("none", ())


def test_steps_that_the_simulator_s_device_had_are_no_change() -> None:
    simulator, trials = identified(0.05), recorded(1.0, 0.05, 1)
    new = prepare(trials, simulator)
    assert new.new_step
    assert new.excess_mse == pytest.approx(1.0 / 12.0, rel=0.2)
    noise = NoiseModel(
        sensor_sigma_deg=0.3,
        drift_sigma_deg_per_sqrt_s=0.1,
        motion_sigma_deg_per_sqrt_unit=0.1,
        sensor_resolution_deg=1.0,
    )
    known = replace(simulator, identification=simulator.identification.model_copy(update={"noise": noise}))
    assert not prepare(trials, known).new_step
    unknown = replace(simulator, identification=simulator.identification.model_copy(update={"residuals": ()}))
    assert prepare(trials, unknown).excess_mse == pytest.approx(1.0 / 12.0, rel=0.01)

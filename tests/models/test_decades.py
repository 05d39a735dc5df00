"""Free of units: the size of command and output, and their names, make no difference to what is found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.decades import Decades
from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds.catalogue import all_kinds, kind_named
from hystmpc.models.kinds.kind import FitRequest, Identified, ModelKind
from hystmpc.models.load import load_model
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel, load_simulator, save_simulator
from hystmpc.trials.check import check
from hystmpc.trials.errors import ModelError
from hystmpc.trials.trial import Trial, Units

DT = 0.04
# Networks scale by their trials' ranges; to train them all would take minutes.
TRIED = ("backlash", "pi", "bouc_wen", "play_kernel", "maxwell_slip", "maxwell_slip_rate", "svr", "auto")
SIZES = st.sampled_from([10.0**k for k in range(-6, 7)])


def recorded(command: float = 1.0, angle: float = 1.0) -> list[Trial]:
    """Two trials of a loop with a curve and some noise, in units of which a device has so many."""
    trials, rng = [], np.random.default_rng(3)
    for frequency in (0.3, 0.5):
        t = np.arange(0.0, 8.0, DT)
        u = 3.0 + 2.9 * np.sin(2 * np.pi * frequency * t - np.pi / 2) * np.exp(-0.06 * t)
        z, last = np.empty_like(u), u[0]
        for k, value in enumerate(u):
            z[k] = last = min(max(value - 0.4, last), value + 0.4)
        theta = 20.0 + 9.0 * z + 0.3 * z**2 + 0.05 * rng.standard_normal(t.size)
        units = Units("V", "um", inverse=False)
        trials.append(Trial(t, command * u, angle * theta, units=units, source=f"{frequency}.csv"))
    return trials


def found(kind: ModelKind, trials: Sequence[Trial]) -> Identified:
    """A short fit."""
    return kind.fit(trials, FitRequest(kind.trainings[0], steps=8, hold_out=0))


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(k, marks=() if k.name == "backlash" else pytest.mark.slow, id=k.name)
        for k in all_kinds()
        if k.name in TRIED
    ],
)
def test_every_kind_is_free_of_units(kind: ModelKind, tmp_path: Path) -> None:
    command, angle = 1e6, 1e-6
    share = []
    for name, trials in (("plain", recorded()), ("scaled", recorded(command, angle))):
        path = tmp_path / f"{name}.onnx"
        export_onnx(found(kind, trials).bundle, path)
        model = load_model(path)
        assert (model.metadata.command_unit, model.metadata.angle_unit) == ("V", "um")
        share.append([evaluate(model, trial).errors.nrmse for trial in trials])
    np.testing.assert_allclose(share[1], share[0], rtol=0.02)


@pytest.mark.slow
@settings(max_examples=12)
@given(SIZES, SIZES)
def test_the_parameters_scale_with_the_signals(command: float, angle: float) -> None:
    """theta = m (u + c) with u a times and theta b times as large: m grows by b / a, c by a."""
    kind = kind_named("backlash")
    plain, scaled = (found(kind, trials).simulator for trials in (recorded(), recorded(command, angle)))
    assert plain is not None
    assert scaled is not None
    factors = [angle / command] * 2 + [command] * 2
    np.testing.assert_allclose(scaled.chain.values, plain.chain.values * factors, rtol=1e-4)
    noise, usual = scaled.identification.noise, plain.identification.noise
    assert noise is not None
    assert usual is not None
    assert noise.sensor_sigma_deg == pytest.approx(angle * usual.sensor_sigma_deg, rel=1e-2)


@given(SIZES, SIZES)
def test_a_check_finds_the_same(command: float, angle: float) -> None:
    plain, scaled = (check(trials[0]) for trials in (recorded(), recorded(command, angle)))
    assert [(f.topic, f.severity) for f in scaled.findings] == [(f.topic, f.severity) for f in plain.findings]
    text = str(scaled)
    assert "um" in text
    assert "deg" not in text


@given(st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_working_units_are_those_of_a_catheter_and_lead_back(command: float, angle: float) -> None:
    trials = recorded(command, angle)
    decades = Decades.of(trials)
    inside = decades.trials(trials)
    assert 1.0 - 1e-6 <= max(np.ptp(t.command) for t in inside) < 10.0 * (1 + 1e-6)
    assert 10.0 - 1e-5 <= max(np.ptp(t.angle) for t in inside) < 100.0 * (1 + 1e-6)
    assert Decades.of(inside).usual
    swapped = [t.swapped() for t in trials]
    assert Decades.of(swapped) == decades
    np.testing.assert_array_equal(decades.trial(swapped[0]).swapped().angle, inside[0].angle)


def test_a_simulator_of_another_device_is_kept_with_its_units(tmp_path: Path) -> None:
    kind = kind_named("backlash")
    swapped = [trial.swapped() for trial in recorded(1.0, 1e-5)]
    simulator = found(kind, swapped).simulator
    assert simulator is not None
    read = load_simulator(save_simulator(simulator, tmp_path / "inverse.yaml"))
    assert read == simulator
    assert (read.command_unit, read.angle_unit, read.metadata().inverted) == ("um", "V", True)
    forward = replace(simulator, inverse=False)
    assert not forward.metadata().inverted


def test_signs_are_judged_in_every_unit() -> None:
    assert Backlash(1e-9, 1e-9, 0.0, 0.0).m_lo == 1e-9
    with pytest.raises(ModelError, match=r"backlash\.m_lo is -1e-09 deg/cmd, expected"):
        Backlash(-1e-9, 1e-9, 0.0, 0.0)


def test_no_controller_is_built_of_an_output_that_is_no_angle(tmp_path: Path) -> None:
    simulator = found(kind_named("backlash"), recorded()).simulator
    assert simulator is not None
    with pytest.raises(ModelError, match="maps V to um, expected an output in deg"):
        controller_model(ChainModel(simulator, "conditioned"))

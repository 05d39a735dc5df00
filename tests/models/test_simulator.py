"""Simulator files, chain models, their export and their inverse."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.evaluate import free_run
from hystmpc.models.inverse.inverses import AccompaniedPredictor, CompanionInverse, CompiledInverse
from hystmpc.models.load import load_model
from hystmpc.models.model import Predictor
from hystmpc.models.prediction.build import controller_model, predictor_for, surrogate_backlash
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import ChainModel, export_simulator, load_simulator, save_simulator
from hystmpc.trials.errors import ModelError

from ..refusals import names
from .casadi_predictor import CasadiPredictor
from .zoo import CHAINS, DT, simulator

NAMES = list(CHAINS)
INVERTIBLE = ["backlash", "pi"]


@pytest.fixture(params=[pytest.param(name, marks=() if name in INVERTIBLE else pytest.mark.slow) for name in NAMES])
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def excitation(seconds: float = 12.0) -> np.ndarray:
    t = np.arange(0, seconds, DT)
    return 2.9 - 2.8 * np.cos(2 * np.pi * 0.31 * t) * np.exp(-0.05 * t)


def test_a_simulator_file_round_trips(name: str, tmp_path: Path) -> None:
    before = simulator(CHAINS[name])
    assert load_simulator(save_simulator(before, tmp_path / "sim.yaml")) == before


def test_the_exported_model_is_the_simulator(name: str, tmp_path: Path) -> None:
    """Round trip over 1,000 steps within 1e-3 deg; in double it is exact but for rounding."""
    gate = export_simulator(simulator(CHAINS[name]), tmp_path / "model.onnx")
    assert gate.steps >= 1000
    assert max(gate.runtime_deg, gate.casadi_deg) <= 1e-9
    reference, exported = ChainModel(simulator(CHAINS[name])), load_model(tmp_path / "model.onnx")
    u = excitation(40.0)
    np.testing.assert_allclose(free_run(exported, u, 31.0), free_run(reference, u, 31.0), atol=1e-9)


def test_a_free_run_starts_where_the_trial_starts(name: str) -> None:
    """With the command at rest the first angle is the measured one, where the model can show it there."""
    theta = free_run(ChainModel(simulator(CHAINS[name])), np.zeros(5), 23.0)
    np.testing.assert_allclose(theta, 23.0, atol=1e-9)


def predictors(name: str, folder: Path) -> list[Predictor]:
    sim = simulator(CHAINS[name])
    export_simulator(sim, folder / "model.onnx")
    exported = load_model(folder / "model.onnx")
    beside = CompiledPredictor.of_simulator(simulator(CHAINS["backlash"]))
    own = CompiledPredictor.of_simulator(sim)
    return [
        own,
        predictor_for(exported),
        CasadiPredictor(exported.casadi_function(), exported.metadata),
        AccompaniedPredictor(own, beside),
    ]


def test_predictors_of_one_model_agree(name: str, tmp_path: Path) -> None:
    """Compiled from the chain, compiled from the exported graph, CasADi's reference, and with a companion."""
    u = excitation()[:15]
    plans = np.stack([u, u[::-1]])
    results = []
    for predictor in predictors(name, tmp_path):
        state = predictor.initial(40.0, 1.0)
        stepped, x = [], state
        for command in u:
            theta, x = predictor.advance(x, command)
            stepped.append(theta)
        angles, jacobian = predictor.linearise(state, u)
        np.testing.assert_allclose(predictor.rollout(state, plans)[0], stepped, atol=1e-9)
        np.testing.assert_allclose(angles, stepped, atol=1e-9)
        assert np.all(np.triu(jacobian, 1) == 0)
        results.append((predictor.rollout(state, plans), jacobian))
    for rollout, jacobian in results[1:]:
        np.testing.assert_allclose(rollout, results[0][0], atol=1e-9)
        np.testing.assert_allclose(jacobian, results[0][1], atol=1e-9)


@pytest.mark.parametrize("kind", INVERTIBLE)
@given(history=st.lists(st.floats(0.0, 6.0), min_size=1, max_size=6), wanted=st.floats(35.0, 75.0))
def test_forward_after_inverse_is_the_identity_on_the_range(kind: str, history: list[float], wanted: float) -> None:
    """Rate dependence included: the one-step inverse knows the command's true rate."""
    predictor = CompiledPredictor.of_simulator(simulator(CHAINS[kind]))
    inverse = CompiledInverse(predictor, -5.0, 15.0)
    state = predictor.initial(40.0, history[0])
    for u in history:
        _, state = predictor.advance(state, u)
    command = inverse.command(state, wanted, history[-1])
    assert predictor.advance(state, command)[0] == pytest.approx(wanted, abs=1e-8)


def test_inverse_in_the_dead_band_keeps_the_command() -> None:
    predictor = CompiledPredictor.of_simulator(simulator(CHAINS["backlash"]))
    theta, state = predictor.advance(predictor.initial(50.0, 2.4), 2.4)
    assert CompiledInverse(predictor, 0.0, 6.0).command(state, theta, 2.4) == 2.4


@pytest.mark.parametrize(("wanted", "end"), [(500.0, 6.0), (-500.0, 0.0)])
def test_inverse_out_of_reach_is_the_end_of_the_range(wanted: float, end: float) -> None:
    predictor = CompiledPredictor.of_simulator(simulator(CHAINS["pi"]))
    state = predictor.initial(50.0, 2.4)
    assert CompiledInverse(predictor, 0.0, 6.0).command(state, wanted, 2.4) == pytest.approx(end, abs=1e-9)


def test_the_surrogate_of_a_backlash_is_that_backlash(tmp_path: Path) -> None:
    export_simulator(simulator(CHAINS["backlash"]), tmp_path / "model.onnx")
    surrogate = surrogate_backlash(load_model(tmp_path / "model.onnx"))
    np.testing.assert_allclose(surrogate.chain.values, CHAINS["backlash"].values, rtol=1e-6)


def test_a_companion_brings_a_model_close_to_the_wanted_angle() -> None:
    model = ChainModel(simulator(CHAINS["pi"]))
    predictor, inverse = controller_model(model, inverse=surrogate_backlash(model)).predictive
    assert isinstance(inverse, CompanionInverse)
    state, u = predictor.initial(45.0, 2.0), 2.0
    for wanted in 45 + 15 * np.sin(2 * np.pi * 0.1 * np.arange(0, 10, DT)):
        u = inverse.command(state, wanted, u)
        theta, state = predictor.advance(state, u)
        assert abs(theta - wanted) < 2.5  # a 4-parameter backlash stands in for four rate-dependent plays


def edit(path: Path, change: object) -> None:
    data = yaml.safe_load(path.read_text())
    change(data)  # type: ignore[operator]
    path.write_text(yaml.safe_dump(data))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format="other/9"), "expected a simulator file of format"),
        (lambda d: d["chain"].pop("core"), "chain has no 'core'"),
        (lambda d: d["chain"]["core"].update(operator="backlas"), "did you mean 'backlash'"),
        (lambda d: d["chain"].update(before={"operator": "lag"}), "expected a list of operators"),
        (lambda d: d.update(dt_s=-1), "dt_s"),
        (lambda d: d.update(dt_s=1e12), "dt_s: Input should be less than or equal to 100"),
        (lambda d: d.update(dt_s=1e-12), "dt_s: Input should be greater than or equal to 0.00001"),
        (lambda d: d.update(dt_s="010"), "dt_s: expected a valid number, got '010'"),
        (lambda d: d.update(command_rate_per_s=1e300), "command_rate_per_s: Input should be less than or equal to"),
        (lambda d: d["command_limits"].update(upper=1e300), "command_limits.upper: Input should be less"),
        (lambda d: d["trained_angle_deg"].update(lower=-1e300), "trained_angle_deg.lower: Input should be greater"),
        (lambda d: d.update(colour="red"), "unknown key 'colour'"),
        (lambda d: d["trained_command"].update(lower=9.0), "not below upper"),
        (lambda d: d["chain"]["core"]["parameters"].update(m_lo=math.inf), "m_lo is inf"),
    ],
)
def test_a_broken_simulator_file_is_one_line_that_names_it(change: object, message: str, tmp_path: Path) -> None:
    path = save_simulator(simulator(CHAINS["backlash"]), tmp_path / "sim.yaml")
    edit(path, change)
    with pytest.raises(ModelError) as error:
        load_simulator(path)
    assert message in str(error.value)
    assert names(str(error.value), path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"\x80\x04pickle", b"[1, 2", b"- a\n- b\n"])
def test_other_files_are_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "sim.yaml").write_bytes(content)
    with pytest.raises(ModelError, match=r"sim\.yaml"):
        load_model(tmp_path / "sim.yaml")


def test_an_unknown_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="expected a model file"):
        load_model(tmp_path / "model.pkl")

"""The predictor of any exported model against CasADi's own evaluation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hystmpc.models.contract.export import ExportBundle, export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.motions import probe_commands
from hystmpc.models.prediction.build import predictor_for
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.prediction.exported import OnnxPredictor
from hystmpc.models.simulator import simulator_bundle
from hystmpc_lab.performance.lstm_reference import LstmStep, lstm_step_graph
from hystmpc_lab.rivals.svr import SvrStep, svr_step_graph

from ..lab.test_svr import weights as svr_weights
from .casadi_predictor import CasadiPredictor
from .lstm_examples import facts, random_weights
from .zoo import CHAINS, simulator

pytestmark = pytest.mark.slow

PLAN = 3.0 + 2.0 * np.sin(np.arange(11)) + 1e-3 * np.arange(11)


def recurrent() -> ExportBundle:
    """A small LSTM under another name, so that its own kernels do not take it."""
    weights = random_weights(7, 2)
    metadata = facts(weights).model_copy(update={"kind": "another network"})
    return ExportBundle(lstm_step_graph(weights), metadata, LstmStep(weights), probe_commands(metadata))


def window() -> ExportBundle:
    """A history buffer with a stride, too many operations for the engine."""
    weights = svr_weights(stride=2, lags=16)
    rule = {"offset": (0.0,) * weights.state_size, "slope": (0.0,) * weights.state_size}
    changes = {"kind": "svr", "initial": rule, "conditioned": rule, "warmup_samples": weights.state_size}
    metadata = type(recurrent().metadata).parse({**recurrent().metadata.model_dump(), **changes})
    return ExportBundle(svr_step_graph(weights), metadata, SvrStep(weights), probe_commands(metadata))


def plays() -> ExportBundle:
    return simulator_bundle(simulator(CHAINS["pi"]))


SYSTEMS: dict[str, Callable[[], ExportBundle]] = {"recurrent": recurrent, "window": window, "plays": plays}


@pytest.fixture(params=SYSTEMS)
def pair(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[OnnxPredictor, CasadiPredictor]:
    export_onnx(SYSTEMS[request.param](), tmp_path / "model.onnx")
    model = load_onnx(tmp_path / "model.onnx", start="conditioned")
    return OnnxPredictor(model), CasadiPredictor(model.casadi_function(), model.metadata)


def test_it_predicts_as_the_reference(pair: tuple[OnnxPredictor, CasadiPredictor]) -> None:
    ours, reference = pair
    state = reference.initial(40.0, 2.0)
    np.testing.assert_allclose(ours.initial(40.0, 2.0), state, atol=1e-5)
    plans = np.stack([PLAN, PLAN[::-1], np.full(PLAN.size, 3.0)])
    kept = state.copy()
    np.testing.assert_allclose(ours.rollout(state, plans), reference.rollout(state, plans), atol=1e-3)
    np.testing.assert_array_equal(state, kept)
    x = state
    for k, u in enumerate(PLAN):
        theta, x = ours.advance(x, float(u))
        assert theta == pytest.approx(ours.rollout(state, plans)[0, k], abs=1e-3)


@pytest.mark.parametrize("length", [1, 2, 11])
def test_its_jacobian_is_the_references(pair: tuple[OnnxPredictor, CasadiPredictor], length: int) -> None:
    ours, reference = pair
    state = reference.initial(40.0, 2.0)
    theta, jacobian = ours.linearise(state, PLAN[:length])
    expected, exact = reference.linearise(state, PLAN[:length])
    np.testing.assert_allclose(theta, expected, atol=1e-9)
    np.testing.assert_allclose(jacobian, exact, rtol=1e-9, atol=1e-9)
    assert not np.triu(jacobian, 1).any()
    assert jacobian.shape == (length, length)


def test_both_ways_to_the_tangent_are_tried(tmp_path: Path) -> None:
    """Matrices for a buffer that shifts, directions for a recurrent network whose state is dense."""
    ways = []
    for name, system in SYSTEMS.items():
        export_onnx(system(), tmp_path / f"{name}.onnx")
        ways.append(OnnxPredictor(load_onnx(tmp_path / f"{name}.onnx")).uses_matrices)
    assert ways == [False, True, True]


def test_what_is_small_runs_in_the_engine_and_the_rest_does_not(tmp_path: Path) -> None:
    kinds = {}
    for name, system in SYSTEMS.items():
        export_onnx(system(), tmp_path / f"{name}.onnx")
        kinds[name] = type(predictor_for(load_onnx(tmp_path / f"{name}.onnx")))
    assert kinds == {"recurrent": OnnxPredictor, "window": OnnxPredictor, "plays": CompiledPredictor}

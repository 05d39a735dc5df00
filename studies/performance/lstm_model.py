"""The benchmark's network: the one that ships with the package, or seeded random weights that behave like a device."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.contract.bundle import ExportBundle
from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.contract.metadata import ModelMetadata, Range
from hystmpc.models.library import library_file, library_names
from hystmpc.models.lstm.graph import lstm_step_graph
from hystmpc.models.lstm.initial import conditioned_rule, zero_state_rule
from hystmpc.models.lstm.reference import LstmStep
from hystmpc.models.lstm.weights import LstmLayer, LstmWeights
from hystmpc.models.networks.scaling import Scaling
from hystmpc.models.probe import probe_commands

_COMMAND = Range(lower=0.0, upper=6.0)  # tendon [mm]
_ANGLE = Range(lower=29.0, upper=89.0)  # 10 deg/mm
_RATE = 12.0  # mm/s
_DT_S = 0.04
_WARMUP = 50


def lstm_model(hidden: int) -> tuple[OnnxModel, str]:
    """A network with two layers of `hidden` cells as controllers load it, and one line on where it comes from."""
    for name in library_names():
        path = library_file(name)
        if path.suffix == ".onnx":
            model = load_onnx(path, "conditioned")
            if model.metadata.kind == "lstm" and _size(model) == (2, hidden):
                return model, f"built-in {name}, LSTM 2x{hidden}"
    return _random_model(hidden), f"LSTM 2x{hidden}, seeded random weights of gain 10 deg/mm"


def random_weights(hidden: int) -> LstmWeights:
    """Seeded weights whose angle rises with the command, from 29 deg at rest to 89 deg at 6 mm.

    With the small gain of freshly drawn weights an optimiser's first step would be its last. Large input weights make
    the network curved, positive ones along the path of the cells make it rise, and the head scales it to a catheter.
    """
    rng = np.random.default_rng(0)
    spread = 1.0 / np.sqrt(hidden)
    layers = (_layer(rng, 1, hidden, 2.0), _layer(rng, hidden, hidden, 2.0 * spread))
    head = np.abs(rng.uniform(-spread, spread, hidden))
    raw = LstmWeights(layers, head, 0.0, Scaling(_COMMAND.lower, _COMMAND.upper, 0.0, 1.0))
    low, high = _settled(raw, _COMMAND.lower), _settled(raw, _COMMAND.upper)
    gain = (_ANGLE.upper - _ANGLE.lower) / (high - low)
    return LstmWeights(layers, head, -low, Scaling(_COMMAND.lower, _COMMAND.upper, _ANGLE.lower, gain))


def _random_model(hidden: int) -> OnnxModel:
    weights = random_weights(hidden)
    step = LstmStep(weights)
    metadata = ModelMetadata(
        kind="lstm",
        dt_s=_DT_S,
        command_unit="mm",
        command_limits=_COMMAND,
        command_rate=_RATE,
        trained_command=_COMMAND,
        trained_angle=_ANGLE,
        trained_rate=_RATE,
        initial=zero_state_rule(step.state_size),
        conditioned=conditioned_rule(step, _COMMAND, _DT_S, _WARMUP),
        warmup_samples=_WARMUP,
        training_data_hash="",
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lstm.onnx"
        export_onnx(ExportBundle(lstm_step_graph(weights), metadata, step, probe_commands(metadata)), path)
        return load_onnx(path, "conditioned")


def _layer(rng: np.random.Generator, inputs: int, hidden: int, input_spread: float) -> LstmLayer:
    spread = 1.0 / np.sqrt(hidden)
    w_ih = rng.uniform(-input_spread, input_spread, (4 * hidden, inputs))
    cell = slice(2 * hidden, 3 * hidden)
    w_ih[cell] = np.abs(w_ih[cell]) if inputs == 1 else 0.25 * np.abs(w_ih[cell])
    recurrent = rng.uniform(-spread, spread, (4 * hidden, hidden))
    return LstmLayer(w_ih, recurrent, rng.uniform(-spread, spread, 4 * hidden))


def _settled(weights: LstmWeights, u: float) -> float:
    step, state = LstmStep(weights), np.zeros((1, weights.state_size))
    theta: NDArray[np.float64] = np.zeros((1, 1))
    for _ in range(200):
        theta, state = step.advance(state, np.array([[u]]))
    return float(theta[0, 0])


def _size(model: OnnxModel) -> tuple[int, int]:
    weights = LstmWeights.from_arrays(model.initializers)
    return len(weights.layers), weights.hidden

"""Stacked LSTM in plain NumPy: its step and derivative in float64, and its step graph."""

from __future__ import annotations

import numpy as np
import onnx
from scipy.special import expit

from hystmpc.models.model import StepFunction
from hystmpc.models.networks.lstm import LstmLayer, LstmWeights, write_layers
from hystmpc.models.networks.nodes import GraphWriter, network_step_graph
from hystmpc.trials.types import Vec


class LstmStep(StepFunction):
    """Reference step of `weights`; equations in `LstmWeights`.

    The derivative is carried forward along the layers (forward sensitivity) and exact: an LSTM has no kinks.
    """

    def __init__(self, weights: LstmWeights) -> None:
        self.weights = weights
        self.state_size = weights.state_size

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        scaling = self.weights.scaling
        x = (np.asarray(u, dtype=np.float64) - scaling.u_offset) / scaling.u_scale
        following = []
        for layer, (h, c) in zip(self.weights.layers, self._split(state), strict=True):
            i, f, g, o = _gates(layer, x, h)
            c = f * c + i * g
            x = o * np.tanh(c)
            following += [x, c]
        y = x @ self.weights.head_weight[:, None] + self.weights.head_bias
        return scaling.theta_offset + scaling.theta_scale * y, np.concatenate(following, axis=1)

    def jacobian(self, state: Vec, u: float) -> Vec:
        scaling, size, hidden = self.weights.scaling, self.state_size, self.weights.hidden
        identity = np.eye(size, size + 1)
        x = np.array([[(u - scaling.u_offset) / scaling.u_scale]])
        dx = np.zeros((1, size + 1))
        dx[0, size] = 1.0 / scaling.u_scale
        rows = []
        parts = self._split(np.reshape(state, (1, size)))
        for k, (layer, (h, c)) in enumerate(zip(self.weights.layers, parts, strict=True)):
            dh, dc = identity[2 * k * hidden :][:hidden], identity[(2 * k + 1) * hidden :][:hidden]
            i, f, g, o = (gate[0, :, None] for gate in _gates(layer, x, h))
            dz_i, dz_f, dz_g, dz_o = np.split(layer.w_ih @ dx + layer.w_hh @ dh, 4)
            c_old = c[0, :, None]
            c_new = f * c_old + i * g
            dc = f * dc + c_old * f * (1 - f) * dz_f + g * i * (1 - i) * dz_i + i * (1 - g**2) * dz_g
            dx = np.tanh(c_new) * o * (1 - o) * dz_o + o * (1 - np.tanh(c_new) ** 2) * dc
            x = (o * np.tanh(c_new)).T
            rows += [dx, dc]
        return np.concatenate([scaling.theta_scale * self.weights.head_weight[None] @ dx, *rows])

    def _split(self, state: Vec) -> list[tuple[Vec, Vec]]:
        """Pairs (h, c) of each layer, (N, H) each."""
        parts = np.split(np.asarray(state, dtype=np.float64), 2 * len(self.weights.layers), axis=1)
        return list(zip(parts[::2], parts[1::2], strict=True))


def _gates(layer: LstmLayer, x: Vec, h: Vec) -> tuple[Vec, Vec, Vec, Vec]:
    """Input, forget, cell and output gate, (N, H) each, from inputs (N, I) and outputs (N, H) of the last step."""
    i, f, g, o = np.split(x @ layer.w_ih.T + h @ layer.w_hh.T + layer.bias, 4, axis=1)
    return expit(i), expit(f), np.tanh(g), expit(o)


def lstm_step_graph(weights: LstmWeights) -> onnx.GraphProto:
    """Step graph (u [N,1], state [N,S]) -> (theta [N,1], next_state [N,S]) in float32, scalings inside.

    The initializers carry the names of `LstmWeights.to_arrays`, so that `LstmWeights.from_arrays` finds them again.
    """

    def body(writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        hidden, following = write_layers(writer, weights.layers, v, state)
        # The head stands as a row here and as a vector in `to_arrays`; `from_arrays` takes either.
        return writer.affine(hidden, "head", weights.head_weight[None], [weights.head_bias], "y"), following

    return network_step_graph("lstm_step", weights.state_size, weights.scaling, body)

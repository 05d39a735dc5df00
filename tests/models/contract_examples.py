"""A play, a rate-dependent play and an LSTM for the model contract, each as a graph and as its NumPy reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from hystmpc.models.contract.export import ExportBundle
from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.model import StepFunction
from hystmpc.trials.types import Vec

DT_S = 0.04
SLOPE, OFFSET, WIDTH, RATE_GAIN = 10.0, 30.0, 0.3, 0.05
HIDDEN = 16
PROBE = 3.0 - 2.9 * np.cos(2 * np.pi * 0.37 * DT_S * np.arange(700)) * np.linspace(1.0, 0.3, 700)


class Play(StepFunction):
    """z = max(u - r, min(u + r, z)), theta = a z + b."""

    state_size = 1

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        z = np.maximum(u - WIDTH, np.minimum(u + WIDTH, state))
        return SLOPE * z + OFFSET, z

    def jacobian(self, state: Vec, u: float) -> Vec:
        moves = u - WIDTH >= min(u + WIDTH, state[0]) or u + WIDTH <= state[0]
        dz = [0.0, 1.0] if moves else [1.0, 0.0]
        return np.array([[SLOPE * dz[0], SLOPE * dz[1]], dz])


class RatePlay(StepFunction):
    """A play whose half-width grows with speed, r = r0 + k |u - u_last| / dt; state (z, u_last)."""

    state_size = 2

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        width = WIDTH + RATE_GAIN * np.abs(u - state[:, 1:]) / DT_S
        z = np.maximum(u - width, np.minimum(u + width, state[:, :1]))
        return SLOPE * z + OFFSET, np.hstack([z, u])

    def jacobian(self, state: Vec, u: float) -> Vec:
        growth = RATE_GAIN * np.sign(u - state[1]) / DT_S
        width = WIDTH + RATE_GAIN * abs(u - state[1]) / DT_S
        if u - width >= min(u + width, state[0]):
            dz = [0.0, growth, 1.0 - growth]
        else:
            dz = [0.0, -growth, 1.0 + growth] if u + width <= state[0] else [1.0, 0.0, 0.0]
        return np.array([[SLOPE * d for d in dz], dz, [0.0, 0.0, 1.0]])


class Lstm(StepFunction):
    """One LSTM layer and a linear head, gates in the order i, f, g, o."""

    state_size = 2 * HIDDEN

    def __init__(self) -> None:
        rng = np.random.default_rng(3)
        scale = 1 / np.sqrt(HIDDEN)
        # rounded to float32, as the graph has them, but computed with in float64
        self.w_x = np.float64(np.float32(rng.normal(0, 1, (1, 4 * HIDDEN))))
        self.w_h = np.float64(np.float32(rng.normal(0, scale, (HIDDEN, 4 * HIDDEN))))
        self.bias = np.float64(np.float32(rng.normal(0, 0.3, 4 * HIDDEN)))
        self.head = np.float64(np.float32(rng.normal(0, 40 * scale, (HIDDEN, 1))))

    def _gates(self, h: Vec, u: Vec) -> list[Vec]:
        z = (u - 3.0) / 3.0 @ self.w_x + h @ self.w_h + self.bias
        return [np.tanh(p) if k == 2 else 1 / (1 + np.exp(-p)) for k, p in enumerate(np.split(z, 4, axis=1))]

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        h, c = np.split(state, 2, axis=1)
        i, f, g, o = self._gates(h, u)
        c = f * c + i * g
        h = o * np.tanh(c)
        return h @ self.head + 30.0, np.hstack([h, c])

    def jacobian(self, state: Vec, u: float) -> Vec:
        h, c = np.split(state[None], 2, axis=1)
        i, f, g, o = (gate.T for gate in self._gates(h, np.array([[u]])))
        dz = np.hstack([self.w_h.T, np.zeros((4 * HIDDEN, HIDDEN)), self.w_x.T / 3.0])
        dz_i, dz_f, dz_g, dz_o = np.split(dz, 4)
        kept = np.eye(HIDDEN, 2 * HIDDEN + 1, HIDDEN)
        dc = f * kept + c.T * f * (1 - f) * dz_f + g * i * (1 - i) * dz_i + i * (1 - g**2) * dz_g
        shown = np.tanh(f * c.T + i * g)
        dh = shown * o * (1 - o) * dz_o + o * (1 - shown**2) * dc
        return np.vstack([self.head.T @ dh, dh, dc])


def graph_of(nodes: list[onnx.NodeProto], size: int, weights: dict[str, NDArray[np.generic]]) -> onnx.GraphProto:
    kind = TensorProto.FLOAT if any(w.dtype == np.float32 for w in weights.values()) else TensorProto.DOUBLE
    values = [
        helper.make_tensor_value_info(name, kind, ["N", width])
        for name, width in (("u", 1), ("state", size), ("theta", 1), ("next_state", size))
    ]
    tensors = [numpy_helper.from_array(w, name) for name, w in weights.items()]
    return helper.make_graph(nodes, "step", values[:2], values[2:], tensors)


def node(op: str, inputs: str, outputs: str, **attributes: int) -> onnx.NodeProto:
    return helper.make_node(op, inputs.split(), outputs.split(), **attributes)


def play_graph(slope: float = SLOPE) -> onnx.GraphProto:
    nodes = [
        node("Sub", "u r", "low"),
        node("Add", "u r", "high"),
        node("Min", "high state", "held"),
        node("GreaterOrEqual", "low held", "pulls"),
        node("Where", "pulls low held", "next_state"),
        node("Mul", "next_state a", "scaled"),
        node("Add", "scaled b", "theta"),
    ]
    return graph_of(nodes, 1, {"r": np.array(WIDTH), "a": np.array([slope]), "b": np.array([[OFFSET]])})


def rate_graph() -> onnx.GraphProto:
    nodes = [
        node("Split", "state", "z u_last", axis=1, num_outputs=2),
        node("Sub", "u u_last", "du"),
        node("Abs", "du", "speed"),
        node("Mul", "speed k", "growth"),
        node("Add", "growth r", "width"),
        node("Sub", "u width", "low"),
        node("Add", "u width", "high"),
        node("Min", "high z", "held"),
        node("Max", "low held", "z_next"),
        node("Concat", "z_next u", "next_state", axis=-1),
        node("Gemm", "z_next a b", "theta", transB=1),
    ]
    k, a, b = np.array(RATE_GAIN / DT_S), np.array([[SLOPE]]), np.array([OFFSET])
    return graph_of(nodes, 2, {"k": k, "r": np.array(WIDTH), "a": a, "b": b})


def lstm_graph() -> onnx.GraphProto:
    net = Lstm()
    nodes = [
        node("Sub", "u three", "centred"),
        node("Div", "centred three", "x"),
        node("Split", "state halves", "h c", axis=1),
        node("MatMul", "x w_x", "zx"),
        node("MatMul", "h w_h", "zh"),
        node("Add", "zx zh", "zs"),
        node("Add", "zs bias", "z"),
        node("Split", "z", "zi zf zg zo", axis=1, num_outputs=4),
        *(node("Sigmoid", f"z{gate}", gate) for gate in "ifo"),
        node("Tanh", "zg", "g"),
        node("Mul", "f c", "kept"),
        node("Mul", "i g", "added"),
        node("Add", "kept added", "c_next"),
        node("Tanh", "c_next", "shown"),
        node("Mul", "o shown", "h_next"),
        node("Concat", "h_next c_next", "next_state", axis=1),
        node("MatMul", "h_next head", "scaled"),
        node("Add", "scaled thirty", "theta"),
    ]
    weights = {name: np.float32(getattr(net, name)) for name in ("w_x", "w_h", "bias", "head")}
    numbers = {"three": np.float32([3.0]), "thirty": np.float32([30.0]), "halves": np.array([HIDDEN, HIDDEN])}
    return graph_of(nodes, 2 * HIDDEN, weights | numbers)


def metadata(size: int) -> ModelMetadata:
    # A play in contact starts at z = (y - b) / a; entries beyond the first start at zero.
    first = {"offset": [-OFFSET / SLOPE] + [0.0] * (size - 1), "slope": [1 / SLOPE] + [0.0] * (size - 1)}
    resting = {"offset": [0.0] * size, "slope": [0.0] * size}
    return ModelMetadata.parse(
        {
            "kind": "test",
            "dt_s": DT_S,
            "command_unit": "mm",
            "command_limits": {"lower": 0.0, "upper": 6.0},
            "command_rate": 6.0,
            "trained_command": {"lower": 0.0, "upper": 6.0},
            "trained_angle": {"lower": 20.0, "upper": 95.0},
            "trained_rate": 4.0,
            "initial": first,
            "conditioned": resting,
            "warmup_samples": 25,
            "training_data_hash": "0123",
            "training": {"preset": "test", "seed": 1, "rmse_deg": 0.5, "augmented": True},
        }
    )


@dataclass(frozen=True)
class System:
    name: str
    reference: Callable[[], StepFunction]
    graph: Callable[[], onnx.GraphProto]

    def bundle(self) -> ExportBundle:
        reference = self.reference()
        return ExportBundle(self.graph(), metadata(reference.state_size), reference, PROBE)


SYSTEMS = [
    System("play", Play, play_graph),
    System("rate play", RatePlay, rate_graph),
    System("lstm", Lstm, lstm_graph),
]

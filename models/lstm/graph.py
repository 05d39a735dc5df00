"""ONNX graphs of a stacked LSTM: the step of the contract, and the roll-out with the operator LSTM."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import helper

from ..model import Array
from ..networks.nodes import GraphWriter, network_step_graph, tensor
from .weights import LstmLayer, LstmWeights


def lstm_step_graph(weights: LstmWeights) -> onnx.GraphProto:
    """Step graph (u [N,1], state [N,S]) -> (theta [N,1], next_state [N,S]) in float32, scalings inside.

    The initializers carry the names of `LstmWeights.to_arrays`, so that `LstmWeights.from_graph` finds them again.
    """

    def body(writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        hidden, following = write_layers(writer, weights.layers, v, state)
        # The head stands as a row here and as a vector in `to_arrays`; `from_arrays` takes either.
        return writer.affine(hidden, "head", weights.head_weight[None], [weights.head_bias], "y"), following

    return network_step_graph("lstm_step", weights.state_size, weights.scaling, body)


def write_layers(writer: GraphWriter, layers: tuple[LstmLayer, ...], v: str, state: str) -> tuple[str, list[str]]:
    """Nodes of stacked LSTM layers over input `v` [N,1] and state [h_1, c_1, h_2, c_2, ...].

    c' = f c + i g, h' = o tanh(c'), see `LstmWeights`; returns the last h' and the parts of the next state.
    """
    hidden, count = layers[0].hidden, len(layers)
    writer.split(state, [hidden] * (2 * count), [f"{name}_{k}" for k in range(count) for name in ("h", "c")])
    following, x = [], v
    for k, layer in enumerate(layers):
        following += _write_layer(writer, k, layer, x)
        x = following[-2]
    return x, following


def _write_layer(writer: GraphWriter, k: int, layer: LstmLayer, x: str) -> list[str]:
    names = {part: writer.weight(f"lstm.{k}.{part}", getattr(layer, part)) for part in ("w_ih", "w_hh", "bias")}
    writer.node("Gemm", [x, names["w_ih"], names["bias"]], f"zx_{k}", transB=1)
    writer.node("Gemm", [f"h_{k}", names["w_hh"], f"zx_{k}"], f"z_{k}", transB=1)
    writer.split(f"z_{k}", [layer.hidden] * 4, [f"z{gate}_{k}" for gate in "ifgo"])
    for gate, kind in (("i", "Sigmoid"), ("f", "Sigmoid"), ("g", "Tanh"), ("o", "Sigmoid")):
        writer.node(kind, [f"z{gate}_{k}"], f"{gate}_{k}")
    writer.node("Mul", [f"f_{k}", f"c_{k}"], f"kept_{k}")
    writer.node("Mul", [f"i_{k}", f"g_{k}"], f"added_{k}")
    writer.node("Add", [f"kept_{k}", f"added_{k}"], f"c_{k}_next")
    writer.node("Tanh", [f"c_{k}_next"], f"shown_{k}")
    writer.node("Mul", [f"o_{k}", f"shown_{k}"], f"h_{k}_next")
    return [f"h_{k}_next", f"c_{k}_next"]


def lstm_rollout_graph(weights: LstmWeights) -> onnx.GraphProto:
    """Roll-out graph (u [N,H], state [N,S]) -> theta [N,H] in float32 with the fused operator LSTM.

    N and H are free. Each row starts from its own state. Not for CasADi: the operator is outside the step's list.
    """
    hidden, count, writer = weights.hidden, len(weights.layers), GraphWriter()
    for name, axis in (("first", 0), ("direction", 1), ("last", 2)):
        writer.indices(name, [axis])
    writer.node("Transpose", [writer.scale_in(weights.scaling, "u", "v")], "x_time", perm=[1, 0])
    writer.node("Unsqueeze", ["x_time", "last"], "x_0")
    writer.split("state", [hidden] * (2 * count), [f"{name}_{k}" for k in range(count) for name in ("h", "c")])
    for k, layer in enumerate(weights.layers):
        for s in ("h", "c"):
            writer.node("Unsqueeze", [f"{s}_{k}", "first"], f"{s}_{k}_start")
        bias = np.concatenate([_onnx_order(layer.bias), np.zeros(4 * hidden)])
        parts = (("W", _onnx_order(layer.w_ih)), ("R", _onnx_order(layer.w_hh)), ("B", bias))
        operands = [f"x_{k}", *(writer.weight(f"{name}_{k}", array[None]) for name, array in parts)]
        writer.node("LSTM", [*operands, "", f"h_{k}_start", f"c_{k}_start"], f"out_{k}", hidden_size=hidden)
        writer.node("Squeeze", [f"out_{k}", "direction"], f"x_{k + 1}")
    head = writer.weight("head.weight", weights.head_weight[:, None]), writer.weight("head.bias", [weights.head_bias])
    writer.node("MatMul", [f"x_{count}", head[0]], "y_time_0")
    writer.node("Add", ["y_time_0", head[1]], "y_time_1")
    writer.node("Squeeze", ["y_time_1", "last"], "y_time")
    writer.node("Transpose", ["y_time"], "y", perm=[1, 0])
    writer.scale_out("y")
    inputs = [tensor("u", "N", "H"), tensor("state", "N", weights.state_size)]
    return helper.make_graph(writer.nodes, "lstm_rollout", inputs, [tensor("theta", "N", "H")], writer.initializers())


def _onnx_order(gates: Array) -> Array:
    """Rows in the order i, o, f, g of the operator LSTM from i, f, g, o."""
    i, f, g, o = np.split(gates, 4)
    return np.concatenate([i, o, f, g])

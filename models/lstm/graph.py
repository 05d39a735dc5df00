"""ONNX graphs of a stacked LSTM: the step of the contract, and the roll-out with the operator LSTM."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from ..model import Array
from .weights import LstmWeights


def lstm_step_graph(weights: LstmWeights) -> onnx.GraphProto:
    """Step graph (u [N,1], state [N,S]) -> (theta [N,1], next_state [N,S]) in float32, scalings inside.

    The initializers carry the names of `LstmWeights.to_arrays`, so that `LstmWeights.from_graph` finds them again.
    """
    hidden, count = weights.hidden, len(weights.layers)
    old = [f"{name}_{k}" for k in range(count) for name in ("h", "c")]
    new = [f"{name}_{k}_next" for k in range(count) for name in ("h", "c")]
    nodes = _scale_in("x_0")
    nodes.append(helper.make_node("Split", ["state", "sizes"], old, name="split_state", axis=1))
    for k in range(count):
        nodes += _layer_nodes(k, "x_0" if k == 0 else f"h_{k - 1}_next")
    nodes.append(helper.make_node("Concat", new, ["next_state"], name="join_state", axis=1))
    nodes.append(helper.make_node("Gemm", [new[-2], "head.weight", "head.bias"], ["y"], name="head"))
    nodes += _scale_out("y")
    arrays = _float32(weights)
    tensors = [numpy_helper.from_array(array, name) for name, array in arrays.items()]
    tensors.append(numpy_helper.from_array(np.full(2 * count, hidden, np.int64), "sizes"))
    tensors.append(numpy_helper.from_array(np.full(4, hidden, np.int64), "gate_sizes"))
    size = weights.state_size
    return helper.make_graph(
        nodes,
        "lstm_step",
        [_tensor("u", "N", 1), _tensor("state", "N", size)],
        [_tensor("theta", "N", 1), _tensor("next_state", "N", size)],
        tensors,
    )


def lstm_rollout_graph(weights: LstmWeights) -> onnx.GraphProto:
    """Roll-out graph (u [N,H], state [N,S]) -> theta [N,H] in float32 with the fused operator LSTM.

    N and H are free. Each row starts from its own state. Not for CasADi: the operator is outside the step's list.
    """
    hidden, count = weights.hidden, len(weights.layers)
    old = [f"{name}_{k}" for k in range(count) for name in ("h", "c")]
    nodes = [*_scale_in("x"), helper.make_node("Transpose", ["x"], ["x_time"], perm=[1, 0])]
    nodes.append(helper.make_node("Unsqueeze", ["x_time", "last"], ["x_0"]))
    nodes.append(helper.make_node("Split", ["state", "sizes"], old, axis=1))
    for k in range(count):
        nodes += [helper.make_node("Unsqueeze", [f"{s}_{k}", "first"], [f"{s}_{k}_start"]) for s in ("h", "c")]
        operands = [f"x_{k}", f"W_{k}", f"R_{k}", f"B_{k}", "", f"h_{k}_start", f"c_{k}_start"]
        nodes.append(helper.make_node("LSTM", operands, [f"out_{k}"], hidden_size=hidden))
        nodes.append(helper.make_node("Squeeze", [f"out_{k}", "direction"], [f"x_{k + 1}"]))
    nodes.append(helper.make_node("MatMul", [f"x_{count}", "head.weight"], ["y_time_0"]))
    nodes.append(helper.make_node("Add", ["y_time_0", "head.bias"], ["y_time_1"]))
    nodes.append(helper.make_node("Squeeze", ["y_time_1", "last"], ["y_time"]))
    nodes.append(helper.make_node("Transpose", ["y_time"], ["y"], perm=[1, 0]))
    nodes += _scale_out("y")
    arrays = {name: array for name, array in _float32(weights).items() if not name.startswith("lstm.")}
    for k, layer in enumerate(weights.layers):
        zero = np.zeros(4 * hidden, np.float32)
        arrays[f"W_{k}"] = _onnx_order(layer.w_ih)[None]
        arrays[f"R_{k}"] = _onnx_order(layer.w_hh)[None]
        arrays[f"B_{k}"] = np.concatenate([_onnx_order(layer.bias), zero])[None]
    axes = {"first": [0], "direction": [1], "last": [2], "sizes": [hidden] * (2 * count)}
    tensors = [numpy_helper.from_array(array, name) for name, array in arrays.items()]
    tensors += [numpy_helper.from_array(np.array(values, np.int64), name) for name, values in axes.items()]
    inputs = [_tensor("u", "N", "H"), _tensor("state", "N", weights.state_size)]
    return helper.make_graph(nodes, "lstm_rollout", inputs, [_tensor("theta", "N", "H")], tensors)


def _layer_nodes(k: int, x: str) -> list[onnx.NodeProto]:
    """c' = f c + i g, h' = o tanh(c') of layer k with input `x`."""

    def node(kind: str, inputs: list[str], output: str, **attributes: Any) -> onnx.NodeProto:
        return helper.make_node(kind, inputs, [output], name=f"layer_{k}_{output}", **attributes)

    gates = [f"{gate}_{k}" for gate in ("zi", "zf", "zg", "zo")]
    return [
        node("Gemm", [x, f"lstm.{k}.w_ih", f"lstm.{k}.bias"], f"zx_{k}", transB=1),
        node("Gemm", [f"h_{k}", f"lstm.{k}.w_hh", f"zx_{k}"], f"z_{k}", transB=1),
        helper.make_node("Split", [f"z_{k}", "gate_sizes"], gates, name=f"layer_{k}_split_gates", axis=1),
        node("Sigmoid", [f"zi_{k}"], f"i_{k}"),
        node("Sigmoid", [f"zf_{k}"], f"f_{k}"),
        node("Tanh", [f"zg_{k}"], f"g_{k}"),
        node("Sigmoid", [f"zo_{k}"], f"o_{k}"),
        node("Mul", [f"f_{k}", f"c_{k}"], f"kept_{k}"),
        node("Mul", [f"i_{k}", f"g_{k}"], f"added_{k}"),
        node("Add", [f"kept_{k}", f"added_{k}"], f"c_{k}_next"),
        node("Tanh", [f"c_{k}_next"], f"shown_{k}"),
        node("Mul", [f"o_{k}", f"shown_{k}"], f"h_{k}_next"),
    ]


def _scale_in(output: str) -> list[onnx.NodeProto]:
    return [
        helper.make_node("Sub", ["u", "scaling.u_offset"], ["u_centred"], name="centre_command"),
        helper.make_node("Div", ["u_centred", "scaling.u_scale"], [output], name="scale_command"),
    ]


def _scale_out(y: str) -> list[onnx.NodeProto]:
    return [
        helper.make_node("Mul", [y, "scaling.theta_scale"], ["theta_centred"], name="scale_angle"),
        helper.make_node("Add", ["theta_centred", "scaling.theta_offset"], ["theta"], name="centre_angle"),
    ]


def _float32(weights: LstmWeights) -> dict[str, np.ndarray]:
    """Named initializers; the head stands as a column (H, 1)."""
    arrays = {name: array.astype(np.float32) for name, array in weights.to_arrays().items()}
    arrays["head.weight"] = arrays["head.weight"][:, None]
    arrays["head.bias"] = arrays["head.bias"].reshape(1)
    return arrays


def _onnx_order(gates: Array) -> np.ndarray:
    """Rows in the order i, o, f, g of the operator LSTM from i, f, g, o."""
    i, f, g, o = np.split(gates, 4)
    return np.concatenate([i, o, f, g]).astype(np.float32)


def _tensor(name: str, *shape: str | int) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, list(shape))

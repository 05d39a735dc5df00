"""The step graph of a support-vector regression, in double, of standard operators."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from .weights import SvrWeights


def svr_step_graph(weights: SvrWeights) -> onnx.GraphProto:
    """Step graph (u [N,1], state [N,S]) -> (theta [N,1], next_state [N,S]).

    ONNX-ML's SVMRegressor, which skl2onnx writes, is single precision and has no derivative: here the same sum stands
    in matrix products, -gamma |w - s|^2 = 2 gamma w.s - gamma |s|^2 - gamma |w|^2.
    """
    gamma = weights.gamma
    arrays = {
        "u_offset": weights.u_offset,
        "u_scale": weights.u_scale,
        "supports": 2 * gamma * weights.supports.T,
        "support_norms": -gamma * np.sum(weights.supports**2, axis=1),
        "minus_gamma": -gamma,
        "coefficients": weights.coefficients[:, None],
        "bias": weights.bias,
        "theta_scale": weights.theta_scale,
        "theta_offset": weights.theta_offset,
    }
    size = weights.state_size
    lists = {"sizes": [1, size], "features": [1], "places": list(range(0, size + 1, weights.stride))}
    tensors = [numpy_helper.from_array(np.array(value, np.float64), name) for name, value in arrays.items()]
    tensors += [numpy_helper.from_array(np.array(value, np.int64), name) for name, value in lists.items()]
    values = [
        helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["N", width])
        for name, width in (("u", 1), ("state", size), ("theta", 1), ("next_state", size))
    ]
    nodes = [
        _node("Concat", "state u", "commands", axis=1),
        _node("Split", "commands sizes", "oldest next_state", axis=1),
        _node("Gather", "commands places", "window", axis=1),
        _node("Sub", "window u_offset", "centred"),
        _node("Div", "centred u_scale", "w"),
        _node("Mul", "w w", "squares"),
        _node("ReduceSum", "squares features", "square", keepdims=1),
        _node("Mul", "square minus_gamma", "own_norm"),
        _node("MatMul", "w supports", "products"),
        _node("Add", "products support_norms", "shifted"),
        _node("Add", "shifted own_norm", "exponents"),
        _node("Exp", "exponents", "kernels"),
        _node("MatMul", "kernels coefficients", "summed"),
        _node("Add", "summed bias", "y"),
        _node("Mul", "y theta_scale", "scaled"),
        _node("Add", "scaled theta_offset", "theta"),
    ]
    return helper.make_graph(nodes, "svr", values[:2], values[2:], tensors)


def _node(kind: str, inputs: str, outputs: str, **attributes: Any) -> onnx.NodeProto:
    return helper.make_node(kind, inputs.split(), outputs.split(), name=outputs.split()[0], **attributes)

"""The step graph of a play-kernel model, in double."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from hystmpc.trials.errors import ModelError

from .weights import PlayKernelWeights


def play_kernel_graph(weights: PlayKernelWeights) -> onnx.GraphProto:
    """Step graph (u [N,1], state [N,S]) -> (theta [N,1], next_state [N,S]); equations in `PlayKernelWeights`.

    Min and Max have the branch that moves first, so that their derivatives at a tie are those of the reference.
    """
    arrays = {
        "gain": weights.gain,
        "lower": weights.lower,
        "upper": weights.upper,
        "radii": weights.radii[None],
        "knots": weights.knots[:-1],
        "widths": np.diff(weights.knots),
        "slopes": weights.slopes,
        "bias": weights.bias,
        "outer_slope": weights.outer_slope,
        "zero": 0.0,
    }
    if weights.stops is not None:
        arrays |= {"lower_stops": weights.stops[0][:, None], "upper_stops": weights.stops[1][:, None]}
    lists = {"sizes": [1, weights.radii.size], "last": [2], "features": [1, 2]}
    tensors = [numpy_helper.from_array(np.array(value, np.float64), name) for name, value in arrays.items()]
    tensors += [numpy_helper.from_array(np.array(value, np.int64), name) for name, value in lists.items()]
    values = [
        helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["N", size])
        for name, size in (("u", 1), ("state", weights.state_size), ("theta", 1), ("next_state", weights.state_size))
    ]
    nodes = [*_plays(weights.gain < 1), *_readout(weights.stops is not None)]
    return helper.make_graph(nodes, "play_kernel", values[:2], values[2:], tensors)


def _plays(lagged: bool) -> list[onnx.NodeProto]:
    """From command and state to the next state."""
    lag = [
        _node("Sub", "inside v_last", "ahead"),
        _node("Mul", "ahead gain", "approach"),
        _node("Add", "v_last approach", "v"),
    ]
    return [
        _node("Split", "state sizes", "v_last z_last", axis=1),
        _node("Max", "u lower", "above"),
        _node("Min", "above upper", "inside"),
        *(lag if lagged else [_node("Identity", "inside", "v")]),
        _node("Sub", "v radii", "pushed"),
        _node("Add", "v radii", "pulled"),
        _node("Min", "pulled z_last", "held"),
        _node("Max", "pushed held", "z"),
        _node("Concat", "v z", "next_state", axis=1),
    ]


def _readout(stops: bool) -> list[onnx.NodeProto]:
    """From the next state to the angle."""
    nodes = [
        _node("Unsqueeze", "next_state last", "levels"),
        _node("Sub", "levels knots", "beyond"),
        _node("Min", "beyond widths", "capped"),
        _node("Max", "capped zero", "ramps"),
        _node("Mul", "ramps slopes", "weighted"),
        _node("ReduceSum", "weighted features", "summed", keepdims=1),
        _node("Squeeze", "summed last", "rising"),
        _node("Add", "rising bias", "based"),
        _node("Sub", "u inside", "outside"),
        _node("Mul", "outside outer_slope", "continued"),
    ]
    if not stops:
        return [*nodes, _node("Add", "based continued", "theta")]
    return [
        *nodes,
        _node("Add", "based continued", "played"),
        _node("Sub", "v z", "stop"),
        _node("Min", "stop zero", "stop_below"),
        _node("Max", "stop zero", "stop_above"),
        _node("MatMul", "stop_below lower_stops", "from_below"),
        _node("MatMul", "stop_above upper_stops", "from_above"),
        _node("Add", "from_below from_above", "stopped"),
        _node("Add", "played stopped", "theta"),
    ]


def _node(kind: str, inputs: str, outputs: str, **attributes: Any) -> onnx.NodeProto:
    return helper.make_node(kind, inputs.split(), outputs.split(), name=outputs.split()[0], **attributes)


def weights_from_arrays(arrays: Mapping[str, NDArray[Any]]) -> PlayKernelWeights:
    """Read the weights back from the named initializers of a graph that `play_kernel_graph` made.

    Raises:
        ModelError: naming the arrays that are missing, or if the weights do not fit.
    """
    scalars = ("gain", "lower", "upper", "bias", "outer_slope")
    wanted = (*scalars, "radii", "knots", "widths", "slopes")
    missing = [name for name in wanted if name not in arrays]
    if missing:
        raise ModelError(f"play kernel: no array {', '.join(missing)}, available: {', '.join(sorted(arrays))}")
    gain, lower, upper, bias, outer_slope = (float(np.asarray(arrays[name]).item()) for name in scalars)
    starts, widths = np.ravel(arrays["knots"]), np.ravel(arrays["widths"])
    stops = [np.ravel(arrays[name]) for name in ("lower_stops", "upper_stops") if name in arrays]
    return PlayKernelWeights(
        gain=gain,
        lower=lower,
        upper=upper,
        radii=np.ravel(arrays["radii"]),
        knots=np.append(starts, starts[-1] + widths[-1]),
        slopes=np.asarray(arrays["slopes"]),
        bias=bias,
        outer_slope=outer_slope,
        stops=np.stack(stops) if len(stops) == 2 else None,
    )

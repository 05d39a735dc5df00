"""The step graph of a play-kernel model, in double."""

from __future__ import annotations

import numpy as np
import onnx

from ..contract.onnx_nodes import graph_of_nodes, node
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
    nodes = [*_plays(weights.gain < 1), *_readout(weights.stops is not None)]
    return graph_of_nodes("play_kernel", weights.state_size, nodes, arrays, lists)


def _plays(lagged: bool) -> list[onnx.NodeProto]:
    """From command and state to the next state."""
    lag = [
        node("Sub", "inside v_last", "ahead"),
        node("Mul", "ahead gain", "approach"),
        node("Add", "v_last approach", "v"),
    ]
    return [
        node("Split", "state sizes", "v_last z_last", axis=1),
        node("Max", "u lower", "above"),
        node("Min", "above upper", "inside"),
        *(lag if lagged else [node("Identity", "inside", "v")]),
        node("Sub", "v radii", "pushed"),
        node("Add", "v radii", "pulled"),
        node("Min", "pulled z_last", "held"),
        node("Max", "pushed held", "z"),
        node("Concat", "v z", "next_state", axis=1),
    ]


def _readout(stops: bool) -> list[onnx.NodeProto]:
    """From the next state to the angle."""
    nodes = [
        node("Unsqueeze", "next_state last", "levels"),
        node("Sub", "levels knots", "beyond"),
        node("Min", "beyond widths", "capped"),
        node("Max", "capped zero", "ramps"),
        node("Mul", "ramps slopes", "weighted"),
        node("ReduceSum", "weighted features", "summed", keepdims=1),
        node("Squeeze", "summed last", "rising"),
        node("Add", "rising bias", "based"),
        node("Sub", "u inside", "outside"),
        node("Mul", "outside outer_slope", "continued"),
    ]
    if not stops:
        return [*nodes, node("Add", "based continued", "theta")]
    return [
        *nodes,
        node("Add", "based continued", "played"),
        node("Sub", "v z", "stop"),
        node("Min", "stop zero", "stop_below"),
        node("Max", "stop zero", "stop_above"),
        node("MatMul", "stop_below lower_stops", "from_below"),
        node("MatMul", "stop_above upper_stops", "from_above"),
        node("Add", "from_below from_above", "stopped"),
        node("Add", "played stopped", "theta"),
    ]

"""Play-kernel model: its weights, its step and derivative in NumPy, and its step graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self, final

import numpy as np
import onnx
from numpy.typing import ArrayLike, NDArray

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..contract.onnx_nodes import graph_of_nodes, node
from ..model import StepFunction


@dataclass(frozen=True)
class PlayKernelWeights:
    """Play-kernel model: a lag, n plays of fixed radii, and a non-decreasing function of each of them.

        c = min(max(u, lower), upper),  v = v_last + a (c - v_last)
        z_i = max(v - r_i, min(v + r_i, z_i,last)),  z_0 = v
        theta = bias + sum_ik s_ik ramp_k(z_i) + sum_i (l_i min(v - z_i, 0) + h_i max(v - z_i, 0)) + m (u - c)

    with ramp_k(z) = max(0, min(z - knot_k, knot_k+1 - knot_k)) and s, l, h, m >= 0, so that the angle never falls with
    the command. A sum of non-decreasing functions of plays is the Preisach operator with non-negative density,
    discretised in the play's radius; l and h weigh the stops v - z_i, which form the inverse of such an operator. In
    terms of kernels it is regression with the additive linear-spline kernel sum_i min(z_i, z_i'), under monotonicity.
    Beyond the trained commands it is a line of slope m.

    The state is [v, z_1, ..., z_n], S = n + 1.

    Attributes:
        gain: a in (0, 1], one without a lag.
        lower, upper: trained commands [cmd].
        radii: r (n,) [cmd], positive and increasing.
        knots: (K + 1,) [cmd], increasing.
        slopes: s (n + 1, K) [deg/cmd].
        bias: [deg].
        outer_slope: m [deg/cmd].
        stops: (2, n): l and h [deg/cmd]; None for a model without them.

    Source: plays and Preisach operator, Krejci, Hysteresis, Convexity and Dissipation in Hyperbolic Equations (1996),
    II.3; the model and its identification are ours.

    Raises:
        ModelError: if sizes do not fit, a number is not finite, or a slope is negative.
    """

    gain: float
    lower: float
    upper: float
    radii: Vec
    knots: Vec
    slopes: Vec
    bias: float
    outer_slope: float
    stops: Vec | None = field(default=None)

    def __post_init__(self) -> None:
        for name in ("radii", "knots", "slopes", "stops"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _frozen(value))
        arrays = [self.radii, self.knots, self.slopes] + ([] if self.stops is None else [self.stops])
        shape = (self.radii.size + 1, self.knots.size - 1)
        if self.slopes.shape != shape or (self.stops is not None and self.stops.shape != (2, self.radii.size)):
            raise ModelError(f"play kernel: slopes have shape {self.slopes.shape}, expected {shape} and stops (2, n)")
        numbers = np.concatenate([np.ravel(a) for a in arrays] + [[self.gain, self.bias, self.outer_slope]])
        if not np.isfinite(numbers).all() or not 0 < self.gain <= 1 or self.lower >= self.upper:
            raise ModelError(
                f"play kernel: got gain {self.gain} and commands {self.lower} to {self.upper}, "
                "expected finite numbers, a gain in (0, 1] and a range"
            )
        rising = np.all(np.diff(self.knots) > 0) and np.all(np.diff(self.radii, prepend=0.0) > 0)
        least = min(float(a.min()) for a in (self.slopes, *arrays[3:], np.array(self.outer_slope)))
        if not rising or least < 0:
            raise ModelError(
                f"play kernel: least slope {least:.6g}, expected slopes >= 0, radii and knots in increasing order"
            )

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Weights from the named initializers of a graph that `play_kernel_graph` made.

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
        return cls(
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

    @property
    def state_size(self) -> int:
        """Number S = n + 1 of state entries."""
        return self.radii.size + 1


def _frozen(values: ArrayLike) -> Vec:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


@final
class PlayKernelStep(StepFunction):
    """Reference step of `weights`; equations in `PlayKernelWeights`. At a kink the moving branch counts."""

    def __init__(self, weights: PlayKernelWeights) -> None:
        self.weights = weights
        self.state_size = weights.state_size

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        w = self.weights
        u = np.asarray(u, dtype=np.float64)
        inside = np.minimum(np.maximum(u, w.lower), w.upper)
        v = inside if w.gain == 1 else state[:, :1] + w.gain * (inside - state[:, :1])
        following = np.hstack([v, np.maximum(v - w.radii, np.minimum(v + w.radii, state[:, 1:]))])
        theta = w.bias + np.sum(w.slopes * ramps(following, w.knots), axis=(1, 2))[:, None]
        theta = theta + w.outer_slope * (u - inside)
        if w.stops is not None:
            stop = v - following[:, 1:]
            theta = theta + (np.minimum(stop, 0) @ w.stops[0] + np.maximum(stop, 0) @ w.stops[1])[:, None]
        return theta, following

    def jacobian(self, state: Vec, u: float) -> Vec:
        w, size = self.weights, self.state_size
        state = np.asarray(state, dtype=np.float64)
        inside = float(w.lower <= u <= w.upper)
        by_v = np.zeros(size + 1)
        by_v[0], by_v[-1] = 1 - w.gain, w.gain * inside
        _, following = self.advance(state[None], np.array([[u]]))
        v, z = following[0, 0], following[0]
        held = np.minimum(v + w.radii, state[1:])
        moves = (v - w.radii >= held) | (v + w.radii <= state[1:])
        by_z = np.vstack([by_v, np.where(moves[:, None], by_v, np.eye(size, size + 1)[1:])])
        beyond = z[:, None] - w.knots[:-1]
        slope = np.sum(w.slopes * ((beyond >= 0) & (beyond <= np.diff(w.knots))), axis=1)
        by_theta = slope @ by_z
        by_theta[-1] += w.outer_slope * (1 - inside)
        if w.stops is not None:
            stop = v - z[1:]
            by_theta = by_theta + (w.stops[0] * (stop <= 0) + w.stops[1] * (stop >= 0)) @ (by_v - by_z[1:])
        return np.vstack([by_theta, by_z])


def ramps(z: Vec, knots: Vec) -> Vec:
    """ramp_k(z) = max(0, min(z - knot_k, knot_k+1 - knot_k)) with a last axis over the K segments."""
    return np.maximum(np.minimum(z[..., None] - knots[:-1], np.diff(knots)), 0.0)


def play_kernel_graph(weights: PlayKernelWeights) -> onnx.GraphProto:
    """Step graph (u [N,1], state [N,S]) -> (theta [N,1], next_state [N,S]); equations in `PlayKernelWeights`.

    The moving branch is the first operand of Min and Max, so that derivatives at a tie equal the reference's.
    """
    arrays: dict[str, ArrayLike] = {
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

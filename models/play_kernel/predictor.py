"""Compiled predictions of a play-kernel model; equations in `PlayKernelWeights`.

The kernels take a model as a tuple of arrays (numbers (5,), radii (n,), knots (K + 1,), slopes (S, K), levels (S, K),
stops (2, n)) with numbers = gain, lower, upper, bias, outer slope, and levels the value of each function where its
segments start.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final

import numpy as np

from hystmpc.trials.types import Vec

from ..contract.metadata import ModelMetadata
from ..kernels.numba_ import njit
from ..model import InvertiblePredictor
from .weights import PlayKernelWeights

if TYPE_CHECKING:
    from ..contract.load import OnnxModel


def pack_play_kernel(weights: PlayKernelWeights) -> tuple[Any, ...]:
    """Model as arrays for the compiled functions."""
    levels = np.zeros_like(weights.slopes)
    levels[:, 1:] = np.cumsum(weights.slopes * np.diff(weights.knots), axis=1)[:, :-1]
    stops = np.zeros((2, weights.radii.size)) if weights.stops is None else np.array(weights.stops)
    numbers = np.array([weights.gain, weights.lower, weights.upper, weights.bias, weights.outer_slope])
    arrays = (numbers, weights.radii, weights.knots, weights.slopes, levels, stops)
    return tuple(np.array(a, dtype=np.float64, order="C") for a in arrays)


@njit(cache=True, error_model="numpy", nogil=True)
def tangent(model: Any, x: Any, u: float, slope: Any) -> float:
    """Advance x (S,) to the next state and return the angle.

    slope (2 S + 1,) is filled with d theta / d z_i (first d / d v without the stops), whether play i moves (1 or 0),
    and last d theta / d u without the part through v.
    """
    numbers, radii, knots, slopes, levels, stops = model
    gain, lower, upper, bias, outer = numbers
    size, segments = x.size, knots.size - 1
    inside = min(max(u, lower), upper)
    v = inside if gain == 1.0 else x[0] + gain * (inside - x[0])
    x[0] = v
    slope[size] = 1.0
    theta = bias + outer * (u - inside)
    slope[2 * size] = 0.0 if lower <= u <= upper else outer
    stopped = 0.0  # d theta / d v through the stops
    for i in range(1, size):
        z, r = x[i], radii[i - 1]
        held = min(v + r, z)
        moves = v - r >= held or v + r <= z
        x[i] = max(v - r, held)
        slope[size + i] = 1.0 if moves else 0.0
    for i in range(size):
        z = x[i]
        k = min(max(np.searchsorted(knots, z, side="right") - 1, 0), segments - 1)
        step = min(max(z - knots[k], 0.0), knots[k + 1] - knots[k])
        theta += levels[i, k] + slopes[i, k] * step
        slope[i] = slopes[i, k] if knots[0] <= z <= knots[segments] else 0.0
        if i > 0:
            stop = v - z
            by_stop = stops[0, i - 1] if stop < 0.0 else stops[1, i - 1]
            theta += by_stop * stop
            slope[i] -= by_stop
            stopped += by_stop
    slope[0] += stopped
    return theta


@njit(cache=True, error_model="numpy", nogil=True)
def rollout(model: Any, state: Any, plans: Any, theta: Any) -> None:
    """Angles of N plans (N, H) from one state (S,), written into theta (N, H)."""
    x, slope = state.copy(), np.empty(2 * state.size + 1)
    for n in range(plans.shape[0]):
        x[:] = state
        for t in range(plans.shape[1]):
            theta[n, t] = tangent(model, x, plans[n, t], slope)


@njit(cache=True, error_model="numpy", nogil=True)
def linearise(model: Any, state: Any, plan: Any, theta: Any, jacobian: Any) -> None:
    """Angles (H,) and their Jacobian (H, H) along one plan by forward sensitivity."""
    size, gain = state.size, model[0][0]
    lower, upper = model[0][1], model[0][2]
    x, slope = state.copy(), np.empty(2 * state.size + 1)
    moving = np.zeros((size, plan.size))
    for t in range(plan.size):
        u = plan[t]
        theta[t] = tangent(model, x, u, slope)
        moving[0] *= 1.0 - gain
        moving[0, t] = gain if lower <= u <= upper else 0.0
        jacobian[t] = slope[0] * moving[0]
        for i in range(1, size):
            if slope[size + i] > 0.0:
                moving[i] = moving[0]
            jacobian[t] += slope[i] * moving[i]
        jacobian[t, t] += slope[2 * size]


@njit(cache=True, error_model="numpy", nogil=True)
def command_for(model: Any, state: Any, wanted: float, low: Any, high: Any, last: Any) -> Any:
    """Command in [low, high] whose next angle is `wanted`: bracketed Newton, as in `core/inverse.c`."""
    size, gain = state.size, model[0][0]
    x, slope = state.copy(), np.empty(2 * state.size + 1)
    u = min(max(last, low), high)
    tolerance = 1e-11 * max(1.0, abs(wanted))
    for _ in range(200):
        x[:] = state
        miss = wanted - tangent(model, x, u, slope)
        if abs(miss) <= tolerance:
            break
        if miss > 0.0:
            low = u
        else:
            high = u
        if high - low <= 1e-13 * max(1.0, abs(high)):
            break
        d = 0.0
        if model[0][1] <= u <= model[0][2]:
            for i in range(size):
                d += gain * slope[i] * slope[size + i]
        d += slope[2 * size]
        newton = u + miss / d if d > 0.0 else high + 1.0
        u = newton if low < newton < high else 0.5 * (low + high)
    return u


def follow_plays(command: Vec, gain: float, radii: Vec, state: Vec) -> Vec:
    """States (T, 1 + n) after each sample: v += gain (u - v), then p_i = max(v - r_i, min(v + r_i, p_i)).

    Args:
        command: u (T,).
        gain: 1 without a lag.
        radii: r (n,).
        state: v and p before the first sample (1 + n,); not changed.
    """
    states = np.empty((command.size, state.size))
    _follow(np.ascontiguousarray(command), gain, radii, state.copy(), states)
    return states


@njit(cache=True, error_model="numpy", nogil=True)
def _follow(command: Any, gain: float, radii: Any, now: Any, states: Any) -> None:
    for k in range(command.size):
        u = command[k]
        v = u if gain == 1.0 else now[0] + gain * (u - now[0])
        now[0] = v
        states[k, 0] = v
        for i in range(radii.size):
            p = max(v - radii[i], min(v + radii[i], now[i + 1]))
            now[i + 1] = p
            states[k, i + 1] = p


@final
class PlayKernelPredictor(InvertiblePredictor):
    """Compiled predictor and exact inverse of a play-kernel model; generated kernels would compile for minutes."""

    def __init__(self, weights: PlayKernelWeights, metadata: ModelMetadata) -> None:
        super().__init__(metadata)
        self._packed = pack_play_kernel(weights)

    @classmethod
    def of_model(cls, model: OnnxModel) -> PlayKernelPredictor:
        """Predictor of a model file of kind `play_kernel`, from the graph's initializers.

        Raises:
            ModelError: if the initializers are not those of an exported play-kernel model.
        """
        return cls(PlayKernelWeights.from_arrays(model.initializers), model.metadata)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        following = np.array(state, dtype=np.float64)
        theta = tangent(self._packed, following, float(u), np.empty(2 * following.size + 1))
        return float(theta), following

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        theta = np.empty(plans.shape)
        rollout(self._packed, state, np.ascontiguousarray(plans, dtype=np.float64), theta)
        return theta

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        theta, jacobian = np.empty(plan.size), np.empty((plan.size, plan.size))
        linearise(self._packed, state, np.ascontiguousarray(plan, dtype=np.float64), theta, jacobian)
        return theta, jacobian

    def command_for(self, state: Vec, theta: float, low: float, high: float, last: float) -> float:
        return float(command_for(self._packed, state, float(theta), float(low), float(high), float(last)))

"""One step of a play-kernel model and its derivative in NumPy: what the graph is held against."""

from __future__ import annotations

from typing import final

import numpy as np

from ..model import Array, StepFunction
from .weights import PlayKernelWeights


@final
class PlayKernelStep(StepFunction):
    """Reference step of `weights`; equations in `PlayKernelWeights`. At a kink the branch that moves counts."""

    def __init__(self, weights: PlayKernelWeights) -> None:
        self.weights = weights
        self.state_size = weights.state_size

    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        """Angles (N, 1) [deg] and next states (N, S) from states (N, S) and commands (N, 1)."""
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

    def jacobian(self, state: Array, u: float) -> Array:
        """Active-branch derivative of (theta, next state) by (state, u) at one point, shape (1 + S, S + 1)."""
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


def ramps(z: Array, knots: Array) -> Array:
    """ramp_k(z) = max(0, min(z - knot_k, knot_k+1 - knot_k)) with a last axis over the K segments."""
    return np.maximum(np.minimum(z[..., None] - knots[:-1], np.diff(knots)), 0.0)

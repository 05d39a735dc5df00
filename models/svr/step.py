"""One step of a support-vector regression and its derivative in NumPy: what the graph is held against."""

from __future__ import annotations

from typing import final

import numpy as np

from ..model import Array, StepFunction
from .weights import SvrWeights


@final
class SvrStep(StepFunction):
    """Reference step of `weights`; equations in `SvrWeights`."""

    def __init__(self, weights: SvrWeights) -> None:
        self.weights = weights
        self.state_size = weights.state_size

    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        """Angles (N, 1) [deg] and next states (N, S) from states (N, S) and commands (N, 1)."""
        w = self.weights
        commands = np.hstack([state, u])
        y = np.array([self._kernels(row[:: w.stride]) @ w.coefficients for row in commands])[:, None] + w.bias
        return w.theta_offset + w.theta_scale * y, commands[:, 1:]

    def jacobian(self, state: Array, u: float) -> Array:
        """Derivative of (theta, next state) by (state, u) at one point, shape (1 + S, S + 1)."""
        w = self.weights
        commands = np.append(state, u)[:: w.stride]
        weighted = w.coefficients * self._kernels(commands)
        gap = (commands - w.u_offset) / w.u_scale - w.supports
        slope = np.zeros(self.state_size + 1)
        slope[:: w.stride] = -2 * w.gamma * w.theta_scale / w.u_scale * (weighted @ gap)
        return np.vstack([slope, np.eye(self.state_size + 1)[1:]])

    def _kernels(self, commands: Array) -> Array:
        """Kernel values (M,) of one window (L,)."""
        w = self.weights
        gap = (commands - w.u_offset) / w.u_scale - w.supports
        return np.exp(-w.gamma * np.einsum("ml,ml->m", gap, gap))

"""The plain route: products through BLAS, roll-outs by onnxruntime. On any processor, and what the vector kernel is
tested against."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from ..lstm.onnxruntime_ import RolloutSession
from ..lstm.weights import LstmWeights
from . import lstm_kernels
from .network_route import Array, NetworkRoute

Float32 = NDArray[np.float32]


@final
class PlainRoute(NetworkRoute):
    """Matrix products of the library, on as many threads as the process gives BLAS; roll-outs on one."""

    name = "plain"

    def __init__(self, weights: LstmWeights) -> None:
        self.packed, self._roll = lstm_kernels.pack_lstm(weights), RolloutSession(weights)
        self.sample = lstm_kernels.sample
        self._scaling = weights.scaling
        self._shape = (2 * len(weights.layers), weights.hidden)

    def advance(self, state: Array, plan: Array) -> tuple[Array, Array]:
        following, y = self._layers(state), np.empty(plan.size, np.float32)
        lstm_kernels.advance(self.packed, following, self._scaled(plan), y)
        return self._angles(y), following.ravel().astype(np.float64)

    def rollout(self, state: Array, plans: Array) -> Array:
        return self._roll(state.astype(np.float32), plans.astype(np.float32)).astype(np.float64)

    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        y, by_plan = np.empty(plan.size, np.float32), np.zeros((plan.size, plan.size), np.float32)
        lstm_kernels.linearise(self.packed, self._layers(state), self._scaled(plan), y, by_plan)
        gain = self._scaling.theta_scale / self._scaling.u_scale
        return self._angles(y), gain * by_plan.astype(np.float64)

    def _layers(self, state: Array) -> Float32:
        """A float32 copy (2L, H) of the state for a kernel to work on."""
        return np.array(state, dtype=np.float32).reshape(self._shape)

    def _scaled(self, u: Array) -> Float32:
        return np.ascontiguousarray((u - self._scaling.u_offset) / self._scaling.u_scale, dtype=np.float32)

    def _angles(self, y: Float32) -> Array:
        return self._scaling.theta_offset + self._scaling.theta_scale * y.astype(np.float64)

"""The plain route of a stacked GRU: products through BLAS, gates in compiled loops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import gru_kernels
from .network_route import Array, NetworkRoute

Float32 = NDArray[np.float32]


@final
class GruRoute(NetworkRoute):
    """Matrix products of the library, on as many threads as the process gives BLAS.

    Args:
        arrays: initializers of the exported model, see `GruNet.write`.

    Raises:
        ModelError: if some are missing.
    """

    name = "plain"

    def __init__(self, arrays: Mapping[str, ArrayLike]) -> None:
        self.packed, self.sample = gru_kernels.pack_gru(arrays), gru_kernels.sample
        self._u_offset, self._u_scale, self._offset, self._scale = self.packed.scaling.tolist()
        self._shape = (len(self.packed.recurrent), 1, self.packed.head.size)

    def advance(self, state: Array, plan: Array) -> tuple[Array, Array]:
        following = np.array(state, dtype=np.float32).reshape(self._shape)
        y = np.empty((1, plan.size), np.float32)
        gru_kernels.rollout(self.packed, following, self._scaled(plan)[None], y)
        return self._angles(y[0]), following.ravel().astype(np.float64)

    def rollout(self, state: Array, plans: Array) -> Array:
        layer_states = np.repeat(np.array(state, dtype=np.float32).reshape(self._shape), len(plans), axis=1)
        y = np.empty(plans.shape, np.float32)
        gru_kernels.rollout(self.packed, layer_states, self._scaled(plans), y)
        return self._angles(y)

    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        y, by_plan = np.empty(plan.size, np.float32), np.zeros((plan.size, plan.size), np.float32)
        layers = np.array(state, dtype=np.float32).reshape(self._shape[0], self._shape[2])
        gru_kernels.linearise(self.packed, layers, self._scaled(plan), y, by_plan)
        return self._angles(y), self._scale / self._u_scale * by_plan.astype(np.float64)

    def _scaled(self, u: Array) -> Float32:
        return np.ascontiguousarray((u - self._u_offset) / self._u_scale, dtype=np.float32)

    def _angles(self, y: Float32) -> Array:
        return self._offset + self._scale * y.astype(np.float64)

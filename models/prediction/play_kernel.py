"""Predictions of a play-kernel model by kernels of its own."""

from __future__ import annotations

from typing import final

import numpy as np

from ..contract.load import OnnxModel
from ..contract.metadata import ModelMetadata
from ..kernels import play_kernel_kernels as kernels
from ..model import Array
from ..play_kernel.graph import weights_from_arrays
from ..play_kernel.weights import PlayKernelWeights
from .invertible import InvertiblePredictor


@final
class PlayKernelPredictor(InvertiblePredictor):
    """Compiled roll-out, linearisation and exact inverse of a play-kernel model.

    The generated kernels of `CompiledPredictor` would do, but the functions of a dozen plays unroll to thousands of
    lines, which take minutes to compile.
    """

    def __init__(self, weights: PlayKernelWeights, metadata: ModelMetadata) -> None:
        self.dt = metadata.dt_s
        self.command_range = (metadata.trained_command.lower, metadata.trained_command.upper)
        self._packed, self._rule, self._warmup = (
            kernels.pack_play_kernel(weights),
            metadata.conditioned,
            metadata.warmup_samples,
        )

    @classmethod
    def of_model(cls, model: OnnxModel) -> PlayKernelPredictor:
        """Predictor of a loaded model file of kind `play_kernel`; the graph's initializers are all that it needs.

        Raises:
            ModelError: if the initializers are not those of an exported play-kernel model.
        """
        return cls(weights_from_arrays(model.initializers), model.metadata)

    def initial(self, y: float, u: float) -> Array:
        state = self._rule.state(np.array([[y]]))[0]
        for _ in range(self._warmup):
            _, state = self.advance(state, u)
        return state

    def advance(self, state: Array, u: float) -> tuple[float, Array]:
        following = np.array(state, dtype=np.float64)
        theta = kernels.tangent(self._packed, following, float(u), np.empty(2 * following.size + 1))
        return float(theta), following

    def rollout(self, state: Array, plans: Array) -> Array:
        theta = np.empty(plans.shape)
        kernels.rollout(self._packed, state, np.ascontiguousarray(plans, dtype=np.float64), theta)
        return theta

    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        theta, jacobian = np.empty(plan.size), np.empty((plan.size, plan.size))
        kernels.linearise(self._packed, state, np.ascontiguousarray(plan, dtype=np.float64), theta, jacobian)
        return theta, jacobian

    def command_for(self, state: Array, theta: float, low: float, high: float, last: float) -> float:
        return float(kernels.command_for(self._packed, state, float(theta), float(low), float(high), float(last)))

"""Predictions of an LSTM in single precision: roll-outs by onnxruntime, steps and Jacobians by compiled kernels."""

from __future__ import annotations

from typing import Literal, final

import numpy as np
from numpy.typing import NDArray

from ..contract.load import OnnxModel
from ..contract.metadata import ModelMetadata
from ..kernels import lstm_kernels
from ..lstm.onnxruntime_ import RolloutSession
from ..lstm.weights import LstmWeights
from ..model import Array, Predictor

_Float32 = NDArray[np.float32]


@final
class LstmPredictor(Predictor):
    """The fastest route to each prediction of a stacked LSTM; state (S,) as in `LstmWeights`.

    Plans must be finite, as those within command limits are: the kernels' gates clamp, and would turn not-a-number into
    a plausible angle. The matrix products run on as many threads as the process gives BLAS; a control process sets one
    (threadpoolctl), since a second one stalls beside a busy neighbour.
    """

    def __init__(
        self, weights: LstmWeights, metadata: ModelMetadata, start: Literal["initial", "conditioned"] = "conditioned"
    ) -> None:
        self.dt = metadata.dt_s
        self.command_range = (metadata.trained_command.lower, metadata.trained_command.upper)
        self._packed, self._roll = lstm_kernels.pack_lstm(weights), RolloutSession(weights)
        self._scaling = weights.scaling
        self._shape = (2 * len(weights.layers), weights.hidden)
        self._rule = metadata.initial if start == "initial" else metadata.conditioned
        self._warmup = metadata.warmup_samples

    @classmethod
    def of_model(cls, model: OnnxModel, start: Literal["initial", "conditioned"] = "conditioned") -> LstmPredictor:
        """Predictor of a loaded model file of kind `lstm`; the graph's initializers are all that it needs.

        Raises:
            ModelError: if the initializers are not those of an exported LSTM.
        """
        return cls(LstmWeights.from_arrays(model.initializers), model.metadata, start)

    def initial(self, y: float, u: float) -> Array:
        state = self._rule.state(np.array([[y]]))[0]
        for _ in range(self._warmup):
            _, state = self.advance(state, u)
        return state

    def advance(self, state: Array, u: float) -> tuple[float, Array]:
        following, y = self._layers(state), np.empty(1, np.float32)
        lstm_kernels.advance(self._packed, following, self._scaled(np.array([u])), y)
        return float(self._angles(y)[0]), following.ravel().astype(np.float64)

    def rollout(self, state: Array, plans: Array) -> Array:
        return self._roll(state.astype(np.float32), plans.astype(np.float32)).astype(np.float64)

    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        y, by_plan = np.empty(plan.size, np.float32), np.zeros((plan.size, plan.size), np.float32)
        lstm_kernels.linearise(self._packed, self._layers(state), self._scaled(plan), y, by_plan)
        gain = self._scaling.theta_scale / self._scaling.u_scale
        return self._angles(y), gain * by_plan.astype(np.float64)

    def _layers(self, state: Array) -> _Float32:
        """A float32 copy (2L, H) of the state for a kernel to work on."""
        return np.array(state, dtype=np.float32).reshape(self._shape)

    def _scaled(self, u: Array) -> _Float32:
        return np.ascontiguousarray((u - self._scaling.u_offset) / self._scaling.u_scale, dtype=np.float32)

    def _angles(self, y: _Float32) -> Array:
        return self._scaling.theta_offset + self._scaling.theta_scale * y.astype(np.float64)

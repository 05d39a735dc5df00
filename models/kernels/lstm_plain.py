"""The plain route: products through BLAS, roll-outs by onnxruntime. On any processor, and what the vector kernel is
tested against."""

from __future__ import annotations

from typing import final

import numpy as np
import onnx
import onnxruntime as ort

from hystmpc.trials.types import Vec

from ..contract.checks import IR_VERSION, OPSET
from ..networks.lstm import LstmWeights, lstm_rollout_graph
from . import lstm_kernels
from .network_route import Float32, NetworkRoute

_CHUNK = 32  # plans at a time: their gates stay in the second-level cache
_ERRORS_ONLY = 3


@final
class RolloutSession:
    """Roll-outs of one network from one state; from four plans on several times faster than products through BLAS."""

    def __init__(self, weights: LstmWeights) -> None:
        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = _ERRORS_ONLY
        model = onnx.helper.make_model(
            lstm_rollout_graph(weights), opset_imports=[onnx.helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
        )
        content = model.SerializeToString()
        self._run = ort.InferenceSession(content, options, providers=["CPUExecutionProvider"]).run
        self(np.zeros(weights.state_size, np.float32), np.zeros((_CHUNK, 2), np.float32))  # the first run allocates

    def __call__(self, state: Float32, plans: Float32) -> Float32:
        """Angles (N, H) [deg] of plans (N, H) [command unit] from a state (S,)."""
        states = np.tile(state, (min(_CHUNK, len(plans)), 1))
        angles = np.empty_like(plans)
        for first in range(0, len(plans), _CHUNK):
            part = plans[first : first + _CHUNK]
            (theta,) = self._run(["theta"], {"u": part, "state": states[: len(part)]})
            angles[first : first + _CHUNK] = np.asarray(theta)
        return angles


@final
class PlainRoute(NetworkRoute):
    """Matrix products of the library, on as many threads as the process gives BLAS; roll-outs on one."""

    name = "plain"

    def __init__(self, weights: LstmWeights) -> None:
        self.packed, self._roll = lstm_kernels.pack_lstm(weights), RolloutSession(weights)
        self.sample = lstm_kernels.sample
        self._scaling = weights.scaling
        self._shape = (2 * len(weights.layers), weights.hidden)

    def advance(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        following, y = self._layers(state), np.empty(plan.size, np.float32)
        lstm_kernels.advance(self.packed, following, self._scaled(plan), y)
        return self._angles(y), following.ravel().astype(np.float64)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._roll(state.astype(np.float32), plans.astype(np.float32)).astype(np.float64)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        y, by_plan = np.empty(plan.size, np.float32), np.zeros((plan.size, plan.size), np.float32)
        lstm_kernels.linearise(self.packed, self._layers(state), self._scaled(plan), y, by_plan)
        gain = self._scaling.theta_scale / self._scaling.u_scale
        return self._angles(y), gain * by_plan.astype(np.float64)

    def _layers(self, state: Vec) -> Float32:
        """A float32 copy (2L, H) of the state for a kernel to work on."""
        return np.array(state, dtype=np.float32).reshape(self._shape)

    def _scaled(self, u: Vec) -> Float32:
        return np.ascontiguousarray((u - self._scaling.u_offset) / self._scaling.u_scale, dtype=np.float32)

    def _angles(self, y: Float32) -> Vec:
        return self._scaling.theta_offset + self._scaling.theta_scale * y.astype(np.float64)

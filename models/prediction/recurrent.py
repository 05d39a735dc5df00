"""Predictions of recurrent networks in single precision by compiled kernels."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, final

import numpy as np

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from ..contract.metadata import ModelMetadata, Start
from ..kernels.network_route import NetworkRoute
from ..kernels.vector_emitter import SHAPES, VectorShape, host_shape
from ..model import ModelPredictor
from ..networks.lstm import GATED_MARK, LstmWeights

if TYPE_CHECKING:
    from ..contract.load import OnnxModel

VARIABLE = "HYSTMPC_LSTM_KERNEL"


@final
class RoutedPredictor(ModelPredictor):
    """Predictions of a recurrent network in single precision by its fastest route.

    Roll-outs run on as many threads as the process gives BLAS; a control process sets one (threadpoolctl), since a
    second one stalls beside a busy neighbour. What follows from a command or a state that is not finite is
    not-a-number: the kernels' gates would hide it.

    Args:
        metadata: facts of the model file.
        start: rule that makes the initial state.
        route: how to compute.
    """

    def __init__(self, metadata: ModelMetadata, start: Start, route: NetworkRoute) -> None:
        super().__init__(metadata, start)
        self.route = route

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        plan = np.array([u])
        if not _finite(state, plan):
            return np.nan, np.full(state.size, np.nan)
        angles, following = self.route.advance(state, plan)
        return float(angles[0]), following

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        if _finite(state, plans):
            return self.route.rollout(state, plans)
        usable = np.isfinite(plans).all(axis=1) & np.isfinite(state).all()
        angles = np.full(plans.shape, np.nan)
        if usable.any():
            angles[usable] = self.route.rollout(state, plans[usable])
        return angles

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        if not _finite(state, plan):
            return np.full(plan.size, np.nan), np.tril(np.full((plan.size, plan.size), np.nan))
        return self.route.linearise(state, plan)


def _finite(state: Vec, plans: Vec) -> bool:
    # a sum is finite only where all its terms are; one that overflows is no angle either
    return math.isfinite(state.sum() + plans.sum())


def chosen_shape() -> VectorShape | None:
    """The processor's own shape of the vector kernel, None where it has none; or what the user says.

    Environment variable HYSTMPC_LSTM_KERNEL: `auto`, `plain`, or the name of a shape, `avx512` or `avx2`.

    Raises:
        ConfigError: if the variable is anything else.
    """
    wanted = os.environ.get(VARIABLE) or "auto"
    if wanted not in ("auto", "plain", *SHAPES):
        raise ConfigError(f"{VARIABLE}: got {wanted}, available: auto, plain, {', '.join(SHAPES)}")
    return host_shape() if wanted == "auto" else SHAPES.get(wanted)


def chosen_route(weights: LstmWeights) -> NetworkRoute:
    """The vector kernel in the shape that `chosen_shape` gives, the plain route where it gives none.

    Raises:
        ConfigError: if HYSTMPC_LSTM_KERNEL names no route.
    """
    shape = chosen_shape()
    if shape is None:
        from ..kernels.lstm_plain import PlainRoute

        return PlainRoute(weights)
    from ..kernels.lstm_vector import VectorRoute  # the other route's kernels and session are not loaded

    return VectorRoute(weights, shape)


def recurrent_predictor(model: OnnxModel, start: Start = "conditioned") -> RoutedPredictor:
    """The compiled predictor of a model file of kind `lstm` or `gru`; the graph's initializers are all that it needs.

    Raises:
        ModelError: if the initializers are not those of such a network.
        ConfigError: if HYSTMPC_LSTM_KERNEL names no route.
    """
    return RoutedPredictor(model.metadata, start, _route(model))


def _route(model: OnnxModel) -> NetworkRoute:
    weights = model.initializers
    if model.metadata.kind != "gru":
        if GATED_MARK not in weights:
            return chosen_route(LstmWeights.from_arrays(weights))
        from ..kernels.gated import GatedLstmRoute

        return GatedLstmRoute(weights)
    from ..kernels.gru import GruRoute, gru_weights

    if (shape := chosen_shape()) is None:
        return GruRoute(weights)
    from ..kernels.lstm_vector import VectorRoute

    return VectorRoute(gru_weights(weights), shape, cell="gru")

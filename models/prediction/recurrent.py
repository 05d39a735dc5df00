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


class RoutedPredictor(ModelPredictor):
    """Predictions of a recurrent network in single precision by its fastest route.

    What follows from a command or a state that is not finite is not-a-number: the kernels' gates would hide it.

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


@final
class GruPredictor(RoutedPredictor):
    """Compiled prediction of a stacked GRU; state [h_1, h_2, ...] as in `GruNet`.

    Args:
        model: a loaded model file of kind `gru`; the graph's initializers are all that it needs.

    Raises:
        ModelError: if the initializers are not those of an exported GRU.
    """

    def __init__(self, model: OnnxModel) -> None:
        from ..kernels.gru import GruRoute, gru_weights  # an LSTM does not need it

        shape = chosen_shape()
        if shape is None:
            super().__init__(model.metadata, "conditioned", GruRoute(model.initializers))
            return
        from ..kernels.lstm_vector import VectorRoute

        route = VectorRoute(gru_weights(model.initializers), shape, cell="gru")
        super().__init__(model.metadata, "conditioned", route)


@final
class GatedLstmPredictor(RoutedPredictor):
    """Compiled prediction of an increment-gated LSTM; state [w, p_1 ... p_n, h, c] as in `GatedLstmNet`.

    Args:
        model: a loaded model file of kind `lstm`; the graph's initializers are all that it needs.

    Raises:
        ModelError: if the initializers are not those of an exported gated LSTM.
    """

    def __init__(self, model: OnnxModel) -> None:
        from ..kernels.gated import GatedLstmRoute

        super().__init__(model.metadata, "conditioned", GatedLstmRoute(model.initializers))


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


@final
class LstmPredictor(RoutedPredictor):
    """The fastest route to each prediction of a stacked LSTM; state (S,) as in `LstmWeights`.

    Roll-outs run on as many threads as the process gives BLAS; a control process sets one (threadpoolctl), since a
    second one stalls beside a busy neighbour.

    Args:
        weights: of the network.
        metadata: facts of the model file.
        start: rule that makes the initial state.
        route: how to compute; None for the fastest on this processor, see `chosen_route`.
    """

    def __init__(
        self,
        weights: LstmWeights,
        metadata: ModelMetadata,
        start: Start = "conditioned",
        route: NetworkRoute | None = None,
    ) -> None:
        super().__init__(metadata, start, chosen_route(weights) if route is None else route)

    @classmethod
    def of_model(cls, model: OnnxModel, start: Start = "conditioned") -> LstmPredictor:
        """Predictor of a loaded model file of kind `lstm`; the graph's initializers are all that it needs.

        Raises:
            ModelError: if the initializers are not those of an exported LSTM.
            ConfigError: if HYSTMPC_LSTM_KERNEL names no route.
        """
        return cls(LstmWeights.from_arrays(model.initializers), model.metadata, start)


def recurrent_predictor(model: OnnxModel) -> RoutedPredictor:
    """The compiled predictor of a model file of kind `lstm` or `gru`.

    Raises:
        ModelError: if the initializers are not those of such a network.
        ConfigError: if HYSTMPC_LSTM_KERNEL names no route.
    """
    if model.metadata.kind == "gru":
        return GruPredictor(model)
    return GatedLstmPredictor(model) if GATED_MARK in model.initializers else LstmPredictor.of_model(model)

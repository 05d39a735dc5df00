"""Predictions of an LSTM in single precision by compiled kernels."""

from __future__ import annotations

from typing import final

from ..contract.load import OnnxModel
from ..contract.metadata import ModelMetadata
from ..kernels.lstm_choice import chosen_route
from ..kernels.network_route import NetworkRoute
from ..lstm.weights import LstmWeights
from .routed import RoutedPredictor, Start


@final
class LstmPredictor(RoutedPredictor):
    """The fastest route to each prediction of a stacked LSTM; state (S,) as in `LstmWeights`.

    Roll-outs run on as many threads as the
    process gives BLAS; a control process sets one (threadpoolctl), since a second one stalls beside a busy neighbour.

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

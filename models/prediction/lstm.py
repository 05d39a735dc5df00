"""Predictions of an LSTM in single precision by compiled kernels."""

from __future__ import annotations

from typing import Literal, final

import numpy as np

from ..contract.load import OnnxModel
from ..contract.metadata import ModelMetadata
from ..kernels.lstm_choice import chosen_route
from ..kernels.lstm_route import LstmRoute
from ..lstm.weights import LstmWeights
from ..model import Array, Predictor


@final
class LstmPredictor(Predictor):
    """The fastest route to each prediction of a stacked LSTM; state (S,) as in `LstmWeights`.

    What follows from a command or a state that is not finite is not-a-number. Roll-outs run on as many threads as the
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
        start: Literal["initial", "conditioned"] = "conditioned",
        route: LstmRoute | None = None,
    ) -> None:
        self.dt = metadata.dt_s
        self.command_range = (metadata.trained_command.lower, metadata.trained_command.upper)
        self.route = chosen_route(weights) if route is None else route
        self._rule = metadata.initial if start == "initial" else metadata.conditioned
        self._warmup = metadata.warmup_samples

    @classmethod
    def of_model(cls, model: OnnxModel, start: Literal["initial", "conditioned"] = "conditioned") -> LstmPredictor:
        """Predictor of a loaded model file of kind `lstm`; the graph's initializers are all that it needs.

        Raises:
            ModelError: if the initializers are not those of an exported LSTM.
            ConfigError: if HYSTMPC_LSTM_KERNEL names no route.
        """
        return cls(LstmWeights.from_arrays(model.initializers), model.metadata, start)

    def initial(self, y: float, u: float) -> Array:
        state = self._rule.state(np.array([[y]]))[0]
        return self._along(state, np.full(self._warmup, u))[1] if self._warmup else state

    def advance(self, state: Array, u: float) -> tuple[float, Array]:
        angles, following = self._along(state, np.array([u]))
        return float(angles[0]), following

    def rollout(self, state: Array, plans: Array) -> Array:
        if _finite(state, plans):
            return self.route.rollout(state, plans)
        usable = np.isfinite(plans).all(axis=1) & np.isfinite(state).all()
        angles = np.full(plans.shape, np.nan)
        if usable.any():
            angles[usable] = self.route.rollout(state, plans[usable])
        return angles

    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        if not _finite(state, plan):
            return np.full(plan.size, np.nan), np.tril(np.full((plan.size, plan.size), np.nan))
        return self.route.linearise(state, plan)

    def _along(self, state: Array, plan: Array) -> tuple[Array, Array]:
        if not _finite(state, plan):
            return np.full(plan.size, np.nan), np.full(state.size, np.nan)
        return self.route.advance(state, plan)


def _finite(state: Array, plans: Array) -> bool:
    return bool(np.isfinite(state).all() and np.isfinite(plans).all())

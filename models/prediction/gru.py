"""Predictions of a GRU in single precision by compiled kernels."""

from __future__ import annotations

from typing import final

from ..contract.load import OnnxModel
from ..kernels.gru_plain import GruRoute
from .routed import RoutedPredictor


@final
class GruPredictor(RoutedPredictor):
    """Compiled prediction of a stacked GRU; state [h_1, h_2, ...] as in `GruNet`.

    Args:
        model: a loaded model file of kind `gru`; the graph's initializers are all that it needs.

    Raises:
        ModelError: if the initializers are not those of an exported GRU.
    """

    def __init__(self, model: OnnxModel) -> None:
        super().__init__(model.metadata, "conditioned", GruRoute(model.initializers))

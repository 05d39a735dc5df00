"""Which of the routes runs a stacked LSTM here."""

from __future__ import annotations

import os

from hystmpc.trials.errors import ConfigError

from ..lstm.weights import LstmWeights
from .network_route import NetworkRoute
from .vector_shape import SHAPES, host_shape

VARIABLE = "HYSTMPC_LSTM_KERNEL"


def chosen_route(weights: LstmWeights) -> NetworkRoute:
    """The vector kernel in the processor's own shape, the plain route where it has none; or what the user says.

    Environment variable HYSTMPC_LSTM_KERNEL: `auto`, `plain`, or the name of a shape, `avx512` or `avx2`.

    Raises:
        ConfigError: if the variable is anything else.
    """
    wanted = os.environ.get(VARIABLE) or "auto"
    if wanted not in ("auto", "plain", *SHAPES):
        raise ConfigError(f"{VARIABLE}: got {wanted}, available: auto, plain, {', '.join(SHAPES)}")
    shape = host_shape() if wanted == "auto" else SHAPES.get(wanted)
    if shape is None:
        from .lstm_plain import PlainRoute

        return PlainRoute(weights)
    from .lstm_vector import VectorRoute  # the other route's kernels and session are not loaded

    return VectorRoute(weights, shape)

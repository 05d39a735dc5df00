"""The ways to run a recurrent network fast; all take and give what `Predictor` does."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from ..networks.lstm import LstmWeights
from .vector_emitter import SHAPES, host_shape

Float32 = NDArray[np.float32]


class NetworkRoute(ABC):
    """Predictions of one network in single precision; state (S,) as in its model file, everything finite.

    The gates may clamp, and would turn not-a-number into a plausible angle: callers check.

    Attributes:
        name: for tables.
        packed: weights as the kernels read them.
        sample: kernel that moves a few states by one sample, see `follow_loops`.
    """

    name: str
    packed: Any
    sample: Callable[..., None]

    @abstractmethod
    def advance(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        """Angles (K,) [deg] along the plan (K,) [command unit] and the state behind it."""

    @abstractmethod
    def rollout(self, state: Vec, plans: Vec) -> Vec:
        """Angles (N, K) [deg] of the plans (N, K)."""

    @abstractmethod
    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        """Angles (K,) [deg] along the plan (K,) and their derivatives (K, K) by its commands, lower triangular."""


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

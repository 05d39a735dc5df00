"""The ways to run a stacked LSTM fast; all take and give what `Predictor` does."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class LstmRoute(ABC):
    """Predictions of one network in single precision; state (S,) as in `LstmWeights`, everything finite.

    The gates may clamp, and would turn not-a-number into a plausible angle: callers check.

    Attributes:
        name: for tables.
    """

    name: str

    @abstractmethod
    def advance(self, state: Array, plan: Array) -> tuple[Array, Array]:
        """Angles (K,) [deg] along the plan (K,) [command unit] and the state behind it."""

    @abstractmethod
    def rollout(self, state: Array, plans: Array) -> Array:
        """Angles (N, K) [deg] of the plans (N, K)."""

    @abstractmethod
    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        """Angles (K,) [deg] along the plan (K,) and their derivatives (K, K) by its commands, lower triangular."""

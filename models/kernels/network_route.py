"""The ways to run a recurrent network fast; all take and give what `Predictor` does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
    def advance(self, state: Array, plan: Array) -> tuple[Array, Array]:
        """Angles (K,) [deg] along the plan (K,) [command unit] and the state behind it."""

    @abstractmethod
    def rollout(self, state: Array, plans: Array) -> Array:
        """Angles (N, K) [deg] of the plans (N, K)."""

    @abstractmethod
    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        """Angles (K,) [deg] along the plan (K,) and their derivatives (K, K) by its commands, lower triangular."""

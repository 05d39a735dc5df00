"""What every compiled way to run a recurrent network offers; it takes and gives what `Predictor` does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.types import Vec

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

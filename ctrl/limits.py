"""Hard limits on command and command rate, measured from the command really sent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

_ROUNDING = 1e-9  # relative; a limit that was written with fewer digits


@dataclass(frozen=True)
class CommandLimits:
    """Box and rate limits of a command: lower <= u_k <= upper, |u_k - u_{k-1}| <= rate * dt.

    Attributes:
        lower, upper: least and greatest command [mm or bar].
        rate: greatest change per second, either way [mm/s or bar/s].

    Raises:
        ControllerError: if a limit is not finite, the box is empty or the rate is not positive.
    """

    lower: float
    upper: float
    rate: float

    def __post_init__(self) -> None:
        values = (self.lower, self.upper, self.rate)
        if not all(math.isfinite(v) for v in values) or self.lower >= self.upper or self.rate <= 0:
            raise ControllerError(
                f"command limits: got lower {self.lower}, upper {self.upper}, rate {self.rate}, "
                "expected finite lower < upper and rate > 0"
            )

    def __str__(self) -> str:
        return f"{self.lower:g} to {self.upper:g} at {self.rate:g} per s"

    def contains(self, other: CommandLimits) -> bool:
        """Whether `other` allows nothing beyond these limits; rounding of the last digits passes."""
        slack = _ROUNDING * (self.upper - self.lower)
        inside = self.lower - slack <= other.lower and other.upper <= self.upper + slack
        return inside and other.rate <= self.rate * (1 + _ROUNDING)

    def window(self, last: float, dt: float) -> tuple[float, float]:
        """Least and greatest command that may follow `last` after `dt` seconds."""
        last = min(max(last, self.lower), self.upper)
        return max(self.lower, last - self.rate * dt), min(self.upper, last + self.rate * dt)

    def clip(self, u: float, last: float, dt: float) -> float:
        """Nearest admissible command; `last` itself where `u` is not a finite number."""
        low, high = self.window(last, dt)
        return min(max(u if math.isfinite(u) else last, low), high)

    def clip_plans(self, plans: Vec, last: float, dt: float) -> Vec:
        """Nearest admissible plans, sample by sample from the first on; shape (..., H).

        Not-a-number stays what it is, and what follows it too; callers pass finite plans.
        """
        from .plan_kernels import clip_plans  # numba takes longer to import than a planner's first call may

        admissible: Vec = np.array(plans, dtype=np.float64, order="C")
        rows = admissible.reshape(-1, admissible.shape[-1])
        clip_plans(rows, self.lower, self.upper, self.rate * dt, last)
        return admissible

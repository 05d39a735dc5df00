"""Hard limits on command and command rate, measured from the command really sent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import ControllerError

Vec = NDArray[np.float64]


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

        Entries that are not finite come out as any admissible value or as NaN; callers pass finite plans.
        """
        boxed = np.minimum(np.maximum(plans, self.lower), self.upper)
        reach = self.rate * dt
        by_sample = np.moveaxis(boxed, -1, 0)
        previous = np.full(boxed.shape[:-1], min(max(last, self.lower), self.upper))
        for k in range(by_sample.shape[0]):
            previous = np.minimum(np.maximum(by_sample[k], previous - reach), previous + reach)
            by_sample[k] = previous
        return boxed

"""Hard limits on command and command rate, measured from the command really sent; their settings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from hystmpc.trials.config import Positive, Settings
from hystmpc.trials.errors import ControllerError, shown
from hystmpc.trials.types import Vec

# Bounded numbers of all settings of controllers and benches.
Port = Annotated[int, Field(ge=0, le=65535)]

_ROUNDING = 1e-9  # relative; a limit that was written with fewer digits


def number_of(value: object) -> float | None:
    """`value` as a number; None where it is none, such as a text, a truth value, a list or nothing at all."""
    if isinstance(value, str | bytes | bytearray | bool | np.bool_ | complex | np.complexfloating):
        return None
    try:
        return float(value)  # type: ignore[arg-type]  # anything may come from outside
    except Exception:  # noqa: BLE001 - what `__float__` of anything raises
        return None


def numbers_of(values: object) -> Vec:
    """`values` as an array of numbers; a single not-a-number where they are none, such as ragged lists."""
    try:
        array = np.asarray(values)
        usable = array.dtype.kind in "iufO"
        return array.astype(np.float64) if usable else np.array(math.nan)
    except Exception:  # noqa: BLE001 - what `__array__` or `__float__` of anything raises
        return np.array(math.nan)


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
        values = [number_of(v) for v in (self.lower, self.upper, self.rate)]
        known = all(v is not None and math.isfinite(v) for v in values)
        if not known or self.lower >= self.upper or self.rate <= 0:
            raise ControllerError(
                f"command limits: got lower {shown(self.lower, 50)}, upper {shown(self.upper, 50)}, "
                f"rate {shown(self.rate, 50)}, "
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
        # numba takes longer to import than a planner's first call may
        from hystmpc.models.inverse.follow import clip_plans

        admissible: Vec = np.array(plans, dtype=np.float64, order="C")
        rows = admissible.reshape(-1, admissible.shape[-1])
        clip_plans(rows, self.lower, self.upper, self.rate * dt, last)
        return admissible


class LimitsSettings(Settings):
    """Hard limits of the command [mm or bar] and of its rate [mm/s or bar/s].

    Attributes:
        lower: least command [mm or bar].
        upper: greatest command [mm or bar].
        rate_per_s: greatest change of the command [mm/s or bar/s].
    """

    lower: float
    upper: float
    rate_per_s: Positive

    @model_validator(mode="after")
    def _ordered(self) -> LimitsSettings:
        if not self.lower < self.upper:
            raise ValueError(f"got lower {self.lower} and upper {self.upper}, expected lower < upper")
        return self

    def build(self) -> CommandLimits:
        """The limits that the settings name."""
        return CommandLimits(self.lower, self.upper, self.rate_per_s)


class ModelledLimitsSettings(LimitsSettings):
    """Hard limits where a model is known: those of the model may be narrowed, and exceeded only where it is said.

    Attributes:
        beyond_model: whether the limits may be wider than the command limits and rate that the model was made for; its
            predictions there are extrapolated, and the device may not be made for them either.
    """

    beyond_model: Annotated[bool, Field(strict=True)] = False

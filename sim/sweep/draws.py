"""Where a number is drawn from: shared by sweeps, which draw, and tuning, which searches."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any
from zlib import crc32

import numpy as np
from pydantic import Field, model_validator

from hystmpc.trials.config import Settings


class DrawSettings(Settings):
    """One distribution, exactly one of these keys.

    Attributes:
        uniform: lower and upper end.
        log_uniform: lower and upper end, both positive; the logarithm is uniform.
        integer: lowest and highest whole number.
        choice: values, each as likely as the others.
    """

    uniform: tuple[float, float] | None = None
    log_uniform: tuple[float, float] | None = None
    integer: tuple[int, int] | None = None
    choice: tuple[Any, ...] | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _one(self) -> DrawSettings:
        given = {name: value for name in type(self).model_fields if (value := getattr(self, name)) is not None}
        if len(given) != 1:
            raise ValueError(
                f"got {', '.join(given) or 'nothing'}, expected one of uniform, log_uniform, integer, choice"
            )
        (name, value) = next(iter(given.items()))
        if name != "choice" and not value[0] < value[1]:
            raise ValueError(f"{name}: got {value[0]} to {value[1]}, expected the lower end first")
        if name == "log_uniform" and value[0] <= 0:
            raise ValueError(f"log_uniform: got a lower end of {value[0]}, expected a positive one")
        return self

    @property
    def ends(self) -> tuple[Any, ...]:
        """Values that any draw lies between, or all that there are."""
        return next(v for v in (self.choice, self.uniform, self.log_uniform, self.integer) if v is not None)

    def sample(self, random: np.random.Generator) -> Any:
        """One draw, as plain Python."""
        if self.choice is not None:
            return self.choice[int(random.integers(len(self.choice)))]
        if self.integer is not None:
            return int(random.integers(self.integer[0], self.integer[1], endpoint=True))
        if self.log_uniform is not None:
            low, high = self.log_uniform
            return float(np.clip(math.exp(random.uniform(math.log(low), math.log(high))), low, high))
        return float(random.uniform(*self.ends))


def drawn(draws: Mapping[str, DrawSettings], seed: int, number: int) -> dict[str, Any]:
    """Draw number `number` of every path.

    Each path has random numbers of its own, so that neither a further path nor more draws change those there are.
    """
    return {
        path: draw.sample(np.random.default_rng([seed, number, crc32(path.encode())])) for path, draw in draws.items()
    }

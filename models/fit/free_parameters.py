"""Which parameters of a chain a fit may change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import FitError, did_you_mean
from hystmpc.trials.types import Vec

from ..chain import Chain


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """The free ones among a chain's parameters.

    Attributes:
        values: values of all (P,), from which the fixed ones are taken.
        index: positions of the free ones (Q,).
        bounds: physical lower and upper bounds of the free ones (Q,) each.
    """

    values: Vec
    index: NDArray[np.intp]
    bounds: tuple[Vec, Vec]

    @classmethod
    def of(cls, chain: Chain, fixed: Sequence[str]) -> Self:
        """All parameters but those named.

        Raises:
            FitError: if a name is not one of the chain's.
        """
        names = [p.name for p in chain.parameters]
        for name in fixed:
            if name not in names:
                raise FitError(f"no parameter {name!r} to hold fixed, {did_you_mean(name, names)}")
        index = np.flatnonzero([name not in fixed for name in names])
        lower, upper = (np.array([getattr(p, end) for p in chain.parameters]) for end in ("lower", "upper"))
        return cls(chain.values, index, (lower[index], upper[index]))

    def part(self, p: Vec) -> Vec:
        """The free ones (Q,) of all parameters (P,)."""
        return np.asarray(p)[self.index]

    def full(self, q: Vec) -> Vec:
        """All parameters (P,) from the free ones (Q,)."""
        p = self.values.copy()
        p[self.index] = q
        return p

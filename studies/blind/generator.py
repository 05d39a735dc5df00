"""What a withheld effect is: a name, where it acts, and a function of its size."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from hystmpc.trials.types import Vec

from .scene import Scene

Shape = Mapping[str, float]
Site = Literal["drive", "friction", "tip", "sensor"]
Apply = Callable[[Vec, Scene, float, Shape], Vec]


@dataclass(frozen=True)
class Generator:
    """One way to produce an effect; its equation is not the library's.

    Attributes:
        name: its own name, in the sealed answers only.
        label: name of the effect that a diagnosis should give; `unknown` where the library has none.
        site: what `apply` changes: the command on the fine grid, the friction factor (it gets the command there), the
            angle on the fine grid, or the sampled angle.
        typical, greatest: size to begin with, and bound of the search for a size.
        draw: shape numbers besides the size.
        apply: signal (T,), scene, size and shape to the changed signal (T,).
    """

    name: str
    label: str
    site: Site
    typical: float
    greatest: float
    draw: Callable[[np.random.Generator], dict[str, float]]
    apply: Apply


@dataclass(frozen=True)
class Withheld:
    """A generator with its numbers.

    Attributes:
        generator: which.
        size: its strength, in its own unit.
        shape: its other numbers.
    """

    generator: Generator
    size: float
    shape: Shape = field(default_factory=dict)

    def resized(self, size: float) -> Withheld:
        """The same effect of another strength."""
        return replace(self, size=size)


def between(**ranges: tuple[float, float]) -> Callable[[np.random.Generator], dict[str, float]]:
    """Draw uniform shape numbers."""
    return lambda random: {name: float(random.uniform(*ends)) for name, ends in ranges.items()}

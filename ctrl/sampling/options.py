"""What the ways to sample plans have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import ClassVar

from hystmpc.trials.errors import ControllerError


@dataclass(frozen=True)
class SampleOptions:
    """How many plans, and how far apart.

    Attributes:
        samples: plans per iteration N.
        iterations: times the distribution is moved per step.
        sigma: largest standard deviation of the perturbations [mm or bar].
        finest: smallest one as a share of `sigma`.
        seed: of the random numbers.

    Raises:
        ControllerError: if a value is out of bounds.
    """

    title: ClassVar[str] = "sampling MPC"
    most: ClassVar[Mapping[str, float]] = {"finest": 1.0}

    samples: int = 256
    iterations: int = 2
    sigma: float = 0.3
    finest: float = 0.01
    seed: int = 0

    def __post_init__(self) -> None:
        positive = all(getattr(self, f.name) > 0 for f in fields(self) if f.name != "seed")
        if not positive or self.seed < 0 or any(getattr(self, name) > most for name, most in self.most.items()):
            bounds = ", ".join(f"{name} <= {most:g}" for name, most in self.most.items())
            raise ControllerError(f"{self.title}: got {self}, expected positive values, {bounds} and seed >= 0")

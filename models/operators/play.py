"""The play operator: the elementary backlash of which Prandtl-Ishlinskii models are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from .operator import Operator, Parameter, Symbol, check_values, maximum, minimum


def play(u: Symbol, z: Symbol, r: Symbol) -> Symbol:
    """Next state of a play of half-width `r` whose state is `z`: max(u - r, min(u + r, z))."""
    return maximum(u - r, minimum(u + r, z))


@dataclass(frozen=True)
class Play(Operator):
    """Play of half-width r, in the unit of its input.

    z_k = max(u_k - r, min(u_k + r, z_{k-1})), y = z. Rate-independent, with return-point memory.

    Source: S2 eq. (4) with one term; Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989), ch. 1.
    """

    r: float
    name: ClassVar[str] = "play"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("r", "cmd", 0.0, 1e3, "half-width"),)

    @property
    def states(self) -> tuple[str, ...]:
        return ("z",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        z = play(u, x[0], p[0])
        return z, z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return play(u, y, p[0])

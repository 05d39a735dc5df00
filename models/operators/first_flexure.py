"""First flexure: a set that is taken once, by the first or the largest bend."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

from .operator import Operator, Parameter, Symbol, check_values, maximum


@final
@dataclass(frozen=True)
class FirstFlexure(Operator):
    """A set in proportion to how far the largest bend so far went beyond a threshold; it stays.

    m_k = max(m_{k-1}, u_k),  y = u + set max(m_k - threshold, 0)

    A first loading beyond the threshold therefore runs along another slope, 1 + set, and every motion below the
    largest bend so far is shifted and nothing else. A set below zero is one that loses angle. Set 0 is the identity.

    Attributes:
        set: set by bend beyond the threshold [1].
        threshold: bend that leaves no set yet [in].
    """

    set: float
    threshold: float
    name: ClassVar[str] = "first_flexure"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("set", "1", -0.95, 3.0, "set by bend beyond the threshold"),
            Parameter("threshold", "in", -1e4, 1e4, "bend that leaves no set yet"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("m",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        largest = maximum(u, x[0])
        return largest, u + p[0] * maximum(largest - p[1], 0)

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """A device that never was bent further than it is now."""
        del y, p
        return u

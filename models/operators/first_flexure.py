"""First flexure: a set that is taken once, by the first or the largest bend."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values, maximum

_AT_ONCE = 1e-6  # s: all of it is there after a sample


@final
@dataclass(frozen=True)
class FirstFlexure(Operator):
    """A set in proportion to how far the largest bend so far went beyond a threshold; it stays.

    m_k = max(m_{k-1}, u_k),  s_k = set max(m_k - threshold, 0)
    l_k = exp(-dt / tau) (l_{k-1} + s_k - s_{k-1}),  y = u + s - l

    With tau 0 it is taken at once, else late by l, as material flows or a tendon beds in. A first loading beyond the
    threshold therefore runs along another slope, 1 + set, and every motion below the largest bend so far is shifted
    and nothing else. A set below zero is one that loses angle. Set 0 is the identity.

    Attributes:
        set: set by bend beyond the threshold [1].
        threshold: bend that leaves no set yet [in].
        tau_s: time constant of taking it, 0 for at once [s].
    """

    set: float
    threshold: float
    tau_s: float = 0.0
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
            Parameter("tau_s", "s", 0.0, 1e4, "time constant of taking it"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("m", "l")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        largest = maximum(u, x[0])
        before, now = (p[0] * maximum(m - p[1], 0) for m in (x[0], largest))
        late = ca.exp(-dt / maximum(p[2], _AT_ONCE)) * (x[1] + now - before)
        return ca.vertcat(largest, late), u + now - late

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """A device that never was bent further than it is now, and has been there for long."""
        del y, p
        return ca.vertcat(u, 0)

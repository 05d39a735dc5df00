"""Drift: slow change with time and with use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values


@final
@dataclass(frozen=True)
class Drift(Operator):
    """Offset and gain that change linearly with a clock, and an offset that grows with the travel.

    t_k = t_{k-1} + dt,  s_k = s_{k-1} + |u_k - u_{k-1}|
    y   = u + (offset_per_min + gain_per_min u) t / 60 + offset_per_travel s

    Clock and travel are state and start at zero. All rates at 0 are the identity.

    Attributes:
        offset_per_min: change of the offset [in/min].
        gain_per_min: change of the gain, softening if above zero [1/min].
        offset_per_travel: change of the offset by travel of the input [1].
    """

    offset_per_min: float
    gain_per_min: float
    offset_per_travel: float
    name: ClassVar[str] = "drift"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0, 0.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("offset_per_min", "in/min", -1e3, 1e3, "change of the offset with time"),
            Parameter("gain_per_min", "1/min", -1.0, 1.0, "change of the gain with time"),
            Parameter("offset_per_travel", "1", -0.1, 0.1, "change of the offset with travel"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("t", "s", "u")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        t, travel = x[0] + dt, x[1] + ca.fabs(u - x[2])
        return ca.vertcat(t, travel, u), u + (p[0] + p[1] * u) * (t / 60) + p[2] * travel

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(0, 0, u)

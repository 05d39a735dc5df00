"""First-order lag of an actuator, valve or sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values


@dataclass(frozen=True)
class Lag(Operator):
    """First-order lag, exact for an input that is constant over a sample.

    tau y' + y = u  =>  y_k = y_{k-1} + (1 - exp(-dt / tau)) (u_k - y_{k-1})

    Attributes:
        tau_s: time constant [s].
    """

    tau_s: float
    name: ClassVar[str] = "lag"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("tau_s", "s", 1e-4, 1e3, "time constant"),)

    @property
    def states(self) -> tuple[str, ...]:
        return ("y",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        y = x[0] + (1 - ca.exp(-dt / p[0])) * (u - x[0])
        return y, y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return u

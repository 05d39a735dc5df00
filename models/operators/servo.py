"""Servo: a lag of second order that overshoots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values


@final
@dataclass(frozen=True)
class Servo(Operator):
    """Underdamped lag of second order, exact for an input that runs straight between samples.

    y'' + 2 d w y' + w^2 y = w^2 u,  w = 2 d / tau

    with damping ratio d, so that it stays behind a ramp by tau as a lag of first order does. With the ramp's slope
    a = (u_k - u_{k-1}) / dt, what is off from following it, e = y - (u_{k-1} - a tau) and g = v - a, and with s = d w,
    f = w sqrt(1 - d^2), c = cos(f dt), h = sin(f dt) / f,

        y_k = u_k - a tau + exp(-s dt) ((c + s h) e + h g),  v_k = a + exp(-s dt) (-w^2 h e + (c - s h) g)

    At 1 us it is the identity but for a microsecond of the ramp.

    Attributes:
        tau_s: time by which it stays behind a ramp [s].
        damping: ratio to the critical damping, below 1 [1].

    Source: Ogata, Modern Control Engineering (5th ed., 2010), section 5.3.
    """

    tau_s: float
    damping: float
    name: ClassVar[str] = "servo"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(1.0, 0.7)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("tau_s", "s", 1e-6, 1e3, "time by which it stays behind a ramp"),
            Parameter("damping", "1", 0.05, 0.999, "ratio to the critical damping"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("y", "v", "u")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        w = 2 * p[1] / p[0]
        s, f = p[1] * w, w * ca.sqrt(1 - p[1] * p[1])
        left, c, h = ca.exp(-s * dt), ca.cos(f * dt), ca.sin(f * dt) / f
        slope = (u - x[2]) / dt
        e, g = x[0] - x[2] + slope * p[0], x[1] - slope
        y = u - slope * p[0] + left * ((c + s * h) * e + h * g)
        return ca.vertcat(y, slope + left * ((c - s * h) * g - w * w * h * e), u), y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u, 0, u)

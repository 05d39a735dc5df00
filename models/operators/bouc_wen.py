"""Bouc-Wen hysteresis as in the code of S2: one smooth internal variable and a slope for each direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values


@final
@dataclass(frozen=True)
class BoucWen(Operator):
    """A line of direction-dependent slope plus a variable that relaxes along the path of the command.

    h_k     = (a du + delta |du| + h_{k-1}) / (1 + v |du|),  du = u_k - u_{k-1}
    theta_k = alpha(u') u_k + h_k + b,  alpha(u') = (alpha_1 e^{2x} + alpha_2) / (e^{2x} + 1),  x = steepness u'

    Rising, h tends to (a + delta) / v, falling to (delta - a) / v, so a loop that lags has a < 0. The step of h is
    implicit Euler along |du|: its dependence on the sample time is of second order in v |du|. The paper's code takes
    x = du of a sample of a command normalised by 6 mm; per second that is a steepness of 0.04 s / 6 mm. Where x stays
    small only (alpha_1 - alpha_2) steepness shows, so steepness is set, not identified. Nor is delta: it shifts h by
    delta / v and no more, which b does as well.

    It has no inverse in closed form; `models/inverse` searches one.

    Attributes:
        a, delta: growth of h with the command and with its path [deg/cmd].
        v: relaxation of h along the path [1/cmd].
        alpha_1, alpha_2: slopes of a fast rise and a fast fall [deg/cmd].
        steepness: speed scale of the change from one slope to the other [s/cmd].
        b: offset [deg].

    Source: code of S2, not in its text; after Wen, J. Eng. Mech. Div. ASCE 102 (1976).
    """

    a: float
    delta: float
    v: float
    alpha_1: float
    alpha_2: float
    steepness: float
    b: float
    name: ClassVar[str] = "bouc_wen"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("a", "deg/cmd", -1e3, 1e3, "growth of h with the command"),
            Parameter("delta", "deg/cmd", -1e3, 1e3, "growth of h with the path of the command"),
            Parameter("v", "1/cmd", 0.0, 1e4, "relaxation of h along the path"),
            Parameter("alpha_1", "deg/cmd", 0.0, 1e3, "slope of a fast rise"),
            Parameter("alpha_2", "deg/cmd", 0.0, 1e3, "slope of a fast fall"),
            Parameter("steepness", "s/cmd", 0.0, 1e2, "speed scale of the change of slope"),
            Parameter("b", "deg", -1e4, 1e4, "offset"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("u", "h")

    @property
    def settling_samples(self) -> int:
        """Two: the first sample of a held command may still look like a fast motion."""
        return 2

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        a, delta, v, alpha_1, alpha_2, steepness, b = (p[k] for k in range(7))
        du = u - x[0]
        h = (a * du + delta * ca.fabs(du) + x[1]) / (1 + v * ca.fabs(du))
        # The quotient of exponentials overflows for fast motions; this is the same function.
        slope = 0.5 * (alpha_1 + alpha_2) + 0.5 * (alpha_1 - alpha_2) * ca.tanh(steepness * du / dt)
        return ca.vertcat(u, h), slope * u + h + b

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return ca.vertcat(u, y - 0.5 * (p[3] + p[4]) * u - p[6])

"""Rate dependence: a loop that grows with speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values, maximum, minimum

_AT_ONCE = 1e-6  # s: nothing is left after a sample


@final
@dataclass(frozen=True)
class RateDependence(Operator):
    """A play whose half-width grows with the speed of its input, and narrows again in a time of its own.

    v_k = |u_k - u_{k-1}| / dt,  r_k = max(width_s max(1 + growth u_k, 0) v_k, exp(-dt / recovery_s) r_{k-1})
    z_k = max(u_k - (1 - skew) r_k, min(u_k + (1 + skew) r_k, z_{k-1})),  y = z

    With recovery 0 it has no width at rest: the output comes up to the input in the first sample of a hold. With a
    long one, as of a lubricant film or a friction that relaxes slowly, it stays behind. Friction that is in proportion
    to a tendon's tension grows with the command, and along a bend it holds back more of a pull than of a release: a
    negative skew. Width 0 is the identity.

    Attributes:
        width_s: half-width by speed [s], in units per unit per second.
        recovery_s: time in which the width of a fast motion is lost [s].
        growth: of the width with the input [1/in].
        skew: of the width between falling and rising input, -1 to 1 [1].

    Source: S2 eq. (5) with the rate-dependent part of the threshold alone; the recovery is ours.
    """

    width_s: float
    recovery_s: float = 0.0
    growth: float = 0.0
    skew: float = 0.0
    name: ClassVar[str] = "rate_dependence"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("width_s", "s", 0.0, 1e2, "half-width by speed"),
            Parameter("recovery_s", "s", 0.0, 1e4, "time in which the width of a fast motion is lost"),
            Parameter("growth", "1/in", -1e3, 1e3, "growth of the width with the input"),
            Parameter("skew", "1", -1.0, 1.0, "of the width between falling and rising input"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("u", "z", "r")

    @property
    def settling_samples(self) -> int:
        """Two: the first sample of a held input may still look like a fast motion."""
        return 2

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        left = ca.exp(-dt / maximum(p[1], _AT_ONCE)) * x[2]
        width = p[0] * maximum(1 + p[2] * u, 0)
        r = maximum(width * ca.fabs(u - x[0]) / dt, left)
        z = maximum(u - (1 - p[3]) * r, minimum(u + (1 + p[3]) * r, x[1]))
        return ca.vertcat(u, z, r), z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u, u, 0)

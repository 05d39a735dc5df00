"""Rate dependence: a loop that grows with speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values, maximum, minimum

_AT_ONCE = 1e-6  # s: nothing is left after a sample
NEVER = 1e9  # of the input: nothing is lost over a way


@final
@dataclass(frozen=True)
class RateDependence(Operator):
    """A play whose half-width grows with the speed of its input, and narrows again in a time of its own.

    v_k = |u_k - u_{k-1}| / dt,  v_k = s_k + thinning s_k^2
    r_k = max(width_s max(1 + growth u_k, 0) s_k, exp(-dt / recovery_s - |u_k - u_{k-1}| / lost_over) r_{k-1})
    z_k = max(u_k - (1 - skew) r_k, min(u_k + (1 + skew) r_k, z_{k-1})),  y = z

    With recovery 0 it has no width at rest: the output comes up to the input in the first sample of a hold. With a
    long one, as of a lubricant film or a friction that relaxes slowly, it stays behind; what presliding holds back is
    lost over a way instead (Dahl's law). Friction that is in proportion
    to a tendon's tension grows with the command, and along a bend it holds back more of a pull than of a release: a
    negative skew. A film that shears thin makes the width grow like the root of a fast speed. Width 0 is the identity.

    Attributes:
        width_s: half-width by speed [s], in units per unit per second.
        recovery_s: time in which the width of a fast motion is lost [s].
        growth: of the width with the input [1/in].
        skew: of the width between falling and rising input, -1 to 1 [1].
        lost_over: way over which the width of a fast motion is lost [in].
        thinning: inverse of the speed around which the width begins to grow less than in proportion [s/in].

    Source: S2 eq. (5) with the rate-dependent part of the threshold alone; the recovery and what follows are ours.
    """

    width_s: float
    recovery_s: float = 0.0
    growth: float = 0.0
    skew: float = 0.0
    thinning: float = 0.0
    lost_over: float = NEVER
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
            Parameter("thinning", "s/in", 0.0, 1e3, "by which the width grows less than in proportion to a fast speed"),
            Parameter("lost_over", "in", 1e-6, NEVER, "way over which the width of a fast motion is lost"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("u", "z", "r")

    @property
    def settling_samples(self) -> int:
        """Two: the first sample of a held input may still look like a fast motion."""
        return 2

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        moved = ca.fabs(u - x[0])
        left = ca.exp(-dt / maximum(p[1], _AT_ONCE) - moved / p[5]) * x[2]
        width = p[0] * maximum(1 + p[2] * u, 0)
        v = moved / dt
        r = maximum(width * 2 * v / (1 + ca.sqrt(1 + 4 * p[4] * v)), left)
        z = maximum(u - (1 - p[3]) * r, minimum(u + (1 + p[3]) * r, x[1]))
        return ca.vertcat(u, z, r), z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u, u, 0)

"""Rate dependence: a loop that grows with speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values
from .play import play


@final
@dataclass(frozen=True)
class RateDependence(Operator):
    """A play whose half-width grows with the speed of its input.

    r_k = width_s |u_k - u_{k-1}| / dt,  z_k = max(u_k - r_k, min(u_k + r_k, z_{k-1})),  y = z

    At rest it has no width: the output comes up to the input in the first sample of a hold. Width 0 is the identity.

    Attributes:
        width_s: half-width by speed [s], in units per unit per second.

    Source: S2 eq. (5) with the rate-dependent part of the threshold alone.
    """

    width_s: float
    name: ClassVar[str] = "rate_dependence"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("width_s", "s", 0.0, 1e2, "half-width by speed"),)

    @property
    def states(self) -> tuple[str, ...]:
        return ("u", "z")

    @property
    def settling_samples(self) -> int:
        """Two: the first sample of a held input may still look like a fast motion."""
        return 2

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        z = play(u, x[1], p[0] * ca.fabs(u - x[0]) / dt)
        return ca.vertcat(u, z), z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u, u)

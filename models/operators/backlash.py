"""Backlash with two lines: the 4-parameter model of a tendon catheter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values, maximum, minimum


@dataclass(frozen=True)
class Backlash(Operator):
    """Command to angle through a loading line, an unloading line and a flat path between them.

    theta_k = m_lo (u_k + c_lo)   if u_k <= theta_{k-1} / m_lo - c_lo   (unloading)
            = m_up (u_k + c_up)   if u_k >= theta_{k-1} / m_up - c_up   (loading)
            = theta_{k-1}         otherwise

    which, for positive slopes, is max(m_up (u_k + c_up), min(m_lo (u_k + c_lo), theta_{k-1})) wherever the
    unloading line lies above the loading line.

    Attributes:
        m_lo, m_up: slopes of the unloading and the loading line [deg/cmd].
        c_lo, c_up: shifts of the two lines along the command [cmd].

    Source: S2 eq. (1)-(3), after Voros, Automatica 46 (2010); sign convention of the authors' code.
    """

    m_lo: float
    m_up: float
    c_lo: float
    c_up: float
    name: ClassVar[str] = "backlash"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(1.0, 1.0, 0.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("m_lo", "deg/cmd", 1e-3, 1e3, "slope of the unloading line"),
            Parameter("m_up", "deg/cmd", 1e-3, 1e3, "slope of the loading line"),
            Parameter("c_lo", "cmd", -1e3, 1e3, "shift of the unloading line"),
            Parameter("c_up", "cmd", -1e3, 1e3, "shift of the loading line"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("theta",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        m_lo, m_up, c_lo, c_up = (p[k] for k in range(4))
        theta = maximum(m_up * (u + c_up), minimum(m_lo * (u + c_lo), x[0]))
        return theta, theta

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del u, p
        return y

    def gap(self, u: float) -> float:
        """Angle between the unloading and the loading line at command `u` [deg]; negative where they cross."""
        return self.m_lo * (u + self.c_lo) - self.m_up * (u + self.c_up)

    def inverse(self, dead_zone: float = 0.0) -> InverseBacklash:
        """Angle to command by the same two lines; `dead_zone` [deg] of the wish counts as no change."""
        return InverseBacklash(self.m_lo, self.m_up, self.c_lo, self.c_up, dead_zone)


@dataclass(frozen=True)
class InverseBacklash(Operator):
    """Angle to command: the loading line upwards, the unloading line downwards, the last command to stay.

    u_k = theta_k / m_up - c_up  if theta_k > theta_{k-1};  theta_k / m_lo - c_lo  if theta_k < theta_{k-1};
    u_{k-1} if equal. Any noise on the wish flips the branch and jumps across the loop, hence the dead zone: a wish
    within it of the last one acted on is no change (0.027 deg in the authors' code).

    Source: S2 eq. (3).
    """

    m_lo: float
    m_up: float
    c_lo: float
    c_up: float
    dead_zone: float = 0.0
    name: ClassVar[str] = "inverse_backlash"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(1.0, 1.0, 0.0, 0.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        forward = Backlash(self.m_lo, self.m_up, self.c_lo, self.c_up).parameters
        return (*forward, Parameter("dead_zone", "deg", 0.0, 10.0, "change of the wish that counts as none"))

    @property
    def states(self) -> tuple[str, ...]:
        return ("theta", "u")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        m_lo, m_up, c_lo, c_up, dead_zone = (p[k] for k in range(5))
        rising, falling = u > x[0] + dead_zone, u < x[0] - dead_zone
        command = ca.if_else(rising, u / m_up - c_up, ca.if_else(falling, u / m_lo - c_lo, x[1]))
        acted_on = ca.if_else(ca.logic_or(rising, falling), u, x[0])
        return ca.vertcat(acted_on, command), command

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del p
        return ca.vertcat(u, y)

"""The play operator: the elementary backlash of which Prandtl-Ishlinskii models are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values, maximum, minimum


def play(u: Symbol, z: Symbol, r: Symbol) -> Symbol:
    """Next state of a play of half-width `r` whose state is `z`: max(u - r, min(u + r, z))."""
    return maximum(u - r, minimum(u + r, z))


@dataclass(frozen=True)
class Play(Operator):
    """Play of half-width r, in the unit of its input.

    z_k = max(u_k - r, min(u_k + r, z_{k-1})), y = z. Rate-independent, with return-point memory.

    Source: S2 eq. (4) with one term; Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989), ch. 1.
    """

    r: float
    name: ClassVar[str] = "play"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("r", "cmd", 0.0, 1e3, "half-width"),)

    @property
    def states(self) -> tuple[str, ...]:
        return ("z",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        z = play(u, x[0], p[0])
        return z, z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return play(u, y, p[0])


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

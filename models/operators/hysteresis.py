"""Elementary hysteresis: play and stop, backlash with two lines and its inverse, Bouc-Wen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import casadi as ca

from .operator import Number, Operator, Symbol, maximum, minimum, play


@dataclass(frozen=True)
class Play(Operator):
    """Play of half-width r, in the unit of its input.

    z_k = max(u_k - r, min(u_k + r, z_{k-1})), y = z. Rate-independent, with return-point memory.

    Source: S2 (RA-L 2024) eq. (4) with one term; Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989), ch. 1.
    """

    r: Annotated[float, Number("cmd", 0.0, 1e3, 0.0, "half-width")]
    name: ClassVar[str] = "play"
    state_names: ClassVar[tuple[str, ...]] = ("z",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        z = play(u, x[0], p[0])
        return z, z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return play(u, y, p[0])


@final
@dataclass(frozen=True)
class Stop(Operator):
    """Stop of half-width r, the dual of the play: a spring on a slider, whose force turns its sign with the motion.

    z_k = max(u_k - r, min(u_k + r, z_{k-1})),  y = u_k - z_k = min(r, max(-r, u_k - z_{k-1}))

    It never exceeds r, and with the play of the same state it is the identity. It leads its input where the play lags.

    Source: Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989), ch. 1.
    """

    r: Annotated[float, Number("in", 0.0, 1e3, 0.0, "half-width")]
    name: ClassVar[str] = "stop"
    state_names: ClassVar[tuple[str, ...]] = ("z",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        z = play(u, x[0], p[0])
        return z, u - z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return play(u, u - y, p[0])


@dataclass(frozen=True)
class BacklashLines(Operator):
    """The two lines of a backlash: theta = m (u + c) for unloading (`lo`) and loading (`up`)."""

    m_lo: Annotated[float, Number("deg/cmd", 1e-3, 1e3, 1.0, "slope of the unloading line")]
    m_up: Annotated[float, Number("deg/cmd", 1e-3, 1e3, 1.0, "slope of the loading line")]
    c_lo: Annotated[float, Number("cmd", -1e3, 1e3, 0.0, "shift of the unloading line")]
    c_up: Annotated[float, Number("cmd", -1e3, 1e3, 0.0, "shift of the loading line")]


@dataclass(frozen=True)
class Backlash(BacklashLines):
    """Command to angle through a loading line, an unloading line and a flat path between them.

    theta_k = m_lo (u_k + c_lo)   if u_k <= theta_{k-1} / m_lo - c_lo   (unloading)
            = m_up (u_k + c_up)   if u_k >= theta_{k-1} / m_up - c_up   (loading)
            = theta_{k-1}         otherwise

    which, for positive slopes, is max(m_up (u_k + c_up), min(m_lo (u_k + c_lo), theta_{k-1})) wherever the
    unloading line lies above the loading line.

    Source: S2 eq. (1)-(3), after Voros, Automatica 46 (2010); sign convention of the authors' code.
    """

    name: ClassVar[str] = "backlash"
    state_names: ClassVar[tuple[str, ...]] = ("theta",)

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
class InverseBacklash(BacklashLines):
    """Angle to command: the loading line upwards, the unloading line downwards, the last command to stay.

    u_k = theta_k / m_up - c_up  if theta_k > theta_{k-1};  theta_k / m_lo - c_lo  if theta_k < theta_{k-1};
    u_{k-1} if equal. Any noise on the wish flips the branch and jumps across the loop, hence the dead zone: a wish
    within it of the last one acted on is no change (0.027 deg in the authors' code).

    Source: S2 eq. (3).
    """

    dead_zone: Annotated[float, Number("deg", 0.0, 10.0, 0.0, "change of the wish that counts as none")] = 0.0
    name: ClassVar[str] = "inverse_backlash"
    state_names: ClassVar[tuple[str, ...]] = ("theta", "u")

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

    Source: code of S2, not in its text; after Wen, J. Eng. Mech. Div. ASCE 102 (1976).
    """

    a: Annotated[float, Number("deg/cmd", -1e3, 1e3, 0.0, "growth of h with the command")]
    delta: Annotated[float, Number("deg/cmd", -1e3, 1e3, 0.0, "growth of h with the path of the command")]
    v: Annotated[float, Number("1/cmd", 0.0, 1e4, 1.0, "relaxation of h along the path")]
    alpha_1: Annotated[float, Number("deg/cmd", 0.0, 1e3, 1.0, "slope of a fast rise")]
    alpha_2: Annotated[float, Number("deg/cmd", 0.0, 1e3, 1.0, "slope of a fast fall")]
    steepness: Annotated[float, Number("s/cmd", 0.0, 1e2, 0.0, "speed scale of the change of slope")]
    b: Annotated[float, Number("deg", -1e4, 1e4, 0.0, "offset")]
    name: ClassVar[str] = "bouc_wen"
    state_names: ClassVar[tuple[str, ...]] = ("u", "h")

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

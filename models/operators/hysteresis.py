"""Hysteresis operators: play and stop, backlash and its inverse, Bouc-Wen, sums of plays with rising curves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, ClassVar, Self, final

import casadi as ca

from .operator import (
    PLAY_FRICTION,
    Number,
    Operator,
    Parameter,
    Symbol,
    check_speeds,
    maximum,
    minimum,
    play,
    play_friction,
)


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
    """Stop of half-width r, the dual of the play: a spring on a slider, whose force changes its sign with the motion.

    z_k = max(u_k - r, min(u_k + r, z_{k-1})),  y = u_k - z_k = min(r, max(-r, u_k - z_{k-1}))

    Stop and play of the same state add up to the identity. The stop leads its input where the play lags.

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
    """Backlash from command to angle: a loading line, an unloading line and a flat path between them.

    theta_k = m_lo (u_k + c_lo)   if u_k <= theta_{k-1} / m_lo - c_lo   (unloading)
            = m_up (u_k + c_up)   if u_k >= theta_{k-1} / m_up - c_up   (loading)
            = theta_{k-1}         otherwise

    which, for positive slopes, is max(m_up (u_k + c_up), min(m_lo (u_k + c_lo), theta_{k-1})) wherever the unloading
    line lies above the loading line.

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

    def crosses(self, lower: float, upper: float) -> bool:
        """Whether unloading lies below loading somewhere between two commands: it has no inverse there."""
        return min(self.gap(lower), self.gap(upper)) < 0

    def inverse(self, dead_zone: float = 0.0) -> InverseBacklash:
        """Inverse from angle to command with the same lines; changes within `dead_zone` [deg] are ignored."""
        return InverseBacklash(self.m_lo, self.m_up, self.c_lo, self.c_up, dead_zone)


@dataclass(frozen=True)
class InverseBacklash(BacklashLines):
    """Inverse backlash from angle to command: loading line upwards, unloading line downwards, else the last command.

    u_k = theta_k / m_up - c_up  if theta_k > theta_{k-1};  theta_k / m_lo - c_lo  if theta_k < theta_{k-1};
    u_{k-1} if equal. Noise of theta would switch the branch and jump across the loop, hence the dead zone: smaller
    changes of theta are ignored (0.027 deg in the authors' code).

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
    """Bouc-Wen model: a line of direction-dependent slope plus a variable that relaxes along the path of the command.

    h_k     = (a du + delta |du| + h_{k-1}) / (1 + v |du|),  du = u_k - u_{k-1}
    theta_k = alpha(u') u_k + h_k + b,  alpha(u') = (alpha_1 e^{2x} + alpha_2) / (e^{2x} + 1),  x = steepness u'

    Rising, h tends to (a + delta) / v, falling to (delta - a) / v, so a loop that lags has a < 0. The step of h is
    implicit Euler along |du|: its dependence on the sample time is of second order in v |du|. The paper's code takes x
    = du of a sample of a command normalised by 6 mm; per second that is a steepness of 0.04 s / 6 mm. For small x only
    the product (alpha_1 - alpha_2) steepness is identifiable, so steepness is set. So is delta, which only shifts h by
    delta / v as b does.

    It has no inverse in closed form; `models/inverse` computes it numerically.

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
        """Two samples, since the first one of a hold may resemble a fast motion."""
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


_NARROW = 1e-9  # half-width below which a gradual play is the identity [cmd]


@final
@dataclass(frozen=True)
class CurvedPlays(Operator):
    """Sum of rising smooth curves of the command and of its plays.

        z_0 = u,  z_i,k = max(u_k - r_i, min(u_k + r_i, z_i,k-1)),  i = 1..n                       turn 0
                  z_i,k = u_k - s r_i (1 - e) - (u_k-1 - z_i,k-1) e,
                          s = sign(u_k - u_k-1),  e = exp(-|u_k - u_k-1| / (2 r_i))               turn 1
        theta = b + sum_i f_i(z_i),  f_i(low) = 0,  f_i' runs straight between s_ij at the knots j = 0..K

    All curves share K pieces of equal length between `low` and `high`, with linear extrapolation. Slopes are not
    negative and those of z_0 are positive, so that the inverse exists. With equal slopes in each curve it is a
    Prandtl-Ishlinskii model with free radii.

    Where friction depends on speed and direction (rate 1), all r_i are multiplied by the factor of `play_friction`, as
    in a Prandtl-Ishlinskii model.

    A gradual play (turn 1) stops at a reversal and follows the new direction over a travel of some r_i, as in dry
    friction with presliding: u - z is the force of a Dahl element. Its width is that of the sharp one, and z never
    falls while u rises.

    Attributes:
        slopes: s_00..s_0K, s_10..s_nK, n + 1 curves of K + 1 slopes [deg/cmd].
        b: angle where every play is at `low` [deg].
        radii: half-widths r_1..r_n of the plays [cmd].
        low, high: ends of the pieces [cmd].
        pieces: number K of pieces of each curve.
        turn: 0 for sharp plays, 1 for gradual ones.
        speeds: nothing, or (stribeck [1], stribeck_speed [cmd/s], one_way [1]); `rate` 1 in files.

    Raises:
        ModelError: if a value is out of bounds, `speeds` has another length, or the number of slopes is not
            (pieces + 1) times (plays + 1).

    Source: additive operator of the Krasnosel'skii-Pokrovskii type, Krasnosel'skii, Pokrovskii, Systems with Hysteresis
    (1989), section 29. Curves: monotone splines of order 2, Ramsay, Monotone regression splines in action, Statistical
    Science 3 (1988). Gradual plays: Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14 (1976), eq.
    (3) with exponent 1, integrated over a straight move.
    """

    slopes: tuple[float, ...]
    b: float
    radii: tuple[float, ...]
    low: float
    high: float
    pieces: int
    turn: int = 0
    speeds: tuple[float, ...] = ()
    name: ClassVar[str] = "curved_plays"
    shape: ClassVar[tuple[str, ...]] = ("plays", "pieces", "turn", "rate")
    default_sizes: ClassVar[Mapping[str, int]] = {"turn": 0, "rate": 0}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"turn": (0, 1), "rate": (0, 1)}

    def check_sizes(self) -> None:
        check_speeds(self.name, self.speeds, len(PLAY_FRICTION))

    @classmethod
    def template(cls, **structure: int) -> Self:
        plays, pieces = structure["plays"], structure["pieces"]
        slopes = (1.0,) * ((pieces + 1) * (plays + 1))
        turn, speeds = structure.get("turn", 0), (0.0, 1.0, 0.0) if structure.get("rate") else ()
        return cls(slopes, 0.0, (0.0,) * plays, 0.0, 1.0, pieces, turn, speeds)

    @property
    def plays(self) -> int:
        """Number n of plays."""
        return len(self.radii)

    @property
    def rate(self) -> int:
        """Flag: 1 where friction depends on speed and direction, else 0."""
        return int(bool(self.speeds))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        curves = [(i, k) for i in range(self.plays + 1) for k in range(self.pieces + 1)]
        return (
            *(
                Parameter(f"s{i}_{k}", "deg/cmd", 0.0 if i else 1e-6, 1e4, f"slope of play {i} at knot {k}")
                for i, k in curves
            ),
            Parameter("b", "deg", -1e4, 1e4, "angle where every play is at the lower end"),
            *(Parameter(f"r{i}", "cmd", 0.0, 1e4, f"half-width of play {i}") for i in range(1, self.plays + 1)),
            Parameter("low", "cmd", -1e4, 1e4, "lower end of the pieces"),
            Parameter("high", "cmd", -1e4, 1e4, "upper end of the pieces"),
            *(PLAY_FRICTION if self.rate else ()),
        )

    @property
    def states(self) -> tuple[str, ...]:
        plays = tuple(f"z{i}" for i in range(1, self.plays + 1))
        plays = (*plays, "u") if self.turn or self.rate else plays
        return (*plays, "falling") if self.rate else plays

    @property
    def settling_samples(self) -> int:
        """Two samples where the first one of a hold may resemble a fast motion."""
        return 1 + self.rate

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        radii, falling = self._radii(p), []
        if self.rate:
            places = p[len(self.parameters) - len(PLAY_FRICTION) :]
            factor, now = play_friction(u - x[self.plays], x[self.plays + 1], places, dt)
            radii, falling = [factor * radius for radius in radii], [now]
        if self.turn:
            z = [_gradual_play(u, x[self.plays], x[i], radius) for i, radius in enumerate(radii)]
        else:
            z = [play(u, x[i], radius) for i, radius in enumerate(radii)]
        return ca.vertcat(*z, *([u] if self.turn or self.rate else []), *falling), self._angle([u, *z], p)

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        # All plays at one share of their half-widths, linear in y from the middle to each end: both ends are exact.
        radii = self._radii(p)
        middle, upper, lower = (self._angle([u, *(u + side * r for r in radii)], p) for side in (0.0, 1.0, -1.0))
        ends = (self.pieces + 1) * (self.plays + 1) + 1 + self.plays
        little = 1e-9 * p[0] * (p[ends + 1] - p[ends])  # avoids a division by zero
        share = (y - middle) / (ca.if_else(y >= middle, upper - middle, middle - lower) + little)
        z = [u + share * r for r in radii]
        falling = [1.0] if self.rate else []  # a device at rest came down to its present angle
        return ca.vertcat(*z, *([u] if self.turn or self.rate else []), *falling)

    def _radii(self, p: Symbol) -> list[Symbol]:
        first = (self.pieces + 1) * (self.plays + 1) + 1
        return [p[first + i] for i in range(self.plays)]

    def _angle(self, plays: list[Symbol], p: Symbol) -> Symbol:
        """Angle as b plus all curves, a line and parabolas: s_0 (z - low) + sum_k c_k max(z - z_k, 0)^2."""
        knots = self.pieces + 1
        count = knots * len(plays)
        low, high = p[count + len(plays)], p[count + len(plays) + 1]
        width = (high - low) / self.pieces
        total = p[count]
        for i, z in enumerate(plays):
            slopes = [p[i * knots + k] for k in range(knots)]
            bends = [0.0, *((after - before) / (2.0 * width) for before, after in pairwise(slopes)), 0.0]
            total += slopes[0] * (z - low)
            for k in range(knots):
                total += (bends[k + 1] - bends[k]) * ca.fmax(z - (low + k * width), 0.0) ** 2
        return total


def _gradual_play(u: Symbol, before: Symbol, z: Symbol, r: Symbol) -> Symbol:
    """Next state of a gradual play of half-width `r` whose state is `z`, on a straight move from `before` to `u`."""
    behind = maximum(minimum(before - z, r), -r)  # a guessed rest may be impossible
    side = ca.if_else(u >= before, 1.0, -1.0)
    kept = ca.exp(-side * (u - before) / (2.0 * r + _NARROW))
    return u - side * r * (1.0 - kept) - behind * kept

"""Friction beyond a plain play: stick-slip, rate dependence, loading and unloading that differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import casadi as ca

from .hysteresis import play
from .operator import Number, Operator, Symbol, maximum, minimum


@final
@dataclass(frozen=True)
class StickSlip(Operator):
    """A play that is wide while it sticks and narrows with the speed at which it slides (threshold stick-slip).

    r_k = break_away exp(-v_{k-1} / stribeck_speed),  z_k = max(u_k - r_k, min(u_k + r_k, z_{k-1})),  y = z
    memory_s v' + v = |z'|  =>  v_k = s_k + exp(-dt / memory_s) (v_{k-1} - s_k),  s_k = |z_k - z_{k-1}| / dt

    A spring pulls a slider without mass whose friction falls with its speed, and remembers the speed for a while.
    Where break_away > stribeck_speed memory_s it breaks away with a jump d = break_away (1 - exp(-d / (stribeck_speed
    memory_s))), sticks again if the motion is slow and slides at a smaller width if it is fast. Without the memory the
    jump, and the speed above which it slides, would follow from the sample time. A jump takes some samples, however
    short they are. The part of friction that does not fall with speed is the play of the device itself. Break-away 0
    is the identity.

    Source: Stribeck curve and frictional memory as in Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30
    (1994), 1083-1138.
    """

    break_away: Annotated[float, Number("in", 0.0, 1e3, 0.0, "half-width at which it breaks away")]
    stribeck_speed: Annotated[float, Number("in/s", 1e-3, 1e4, 1.0, "speed at which 1/e of it is left")]
    memory_s: Annotated[float, Number("s", 1e-3, 1e2, 0.1, "time for which friction remembers the speed")] = 0.1
    name: ClassVar[str] = "stick_slip"
    state_names: ClassVar[tuple[str, ...]] = ("z", "v")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        z = play(u, x[0], p[0] * ca.exp(-x[1] / p[1]))
        speed = ca.fabs(z - x[0]) / dt
        return ca.vertcat(z, speed + ca.exp(-dt / p[2]) * (x[1] - speed)), z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return ca.vertcat(play(u, y, p[0]), 0)


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

    Source: S2 (RA-L 2024) eq. (5), the rate-dependent part of the threshold alone; recovery and the rest are ours.
    """

    width_s: Annotated[float, Number("s", 0.0, 1e2, 0.0, "half-width by speed")]
    recovery_s: Annotated[float, Number("s", 0.0, 1e4, 0.0, "time in which the width of a fast motion is lost")] = 0.0
    growth: Annotated[float, Number("1/in", -1e3, 1e3, 0.0, "growth of the width with the input")] = 0.0
    skew: Annotated[float, Number("1", -1.0, 1.0, 0.0, "of the width between falling and rising input")] = 0.0
    thinning: Annotated[
        float, Number("s/in", 0.0, 1e3, 0.0, "by which the width grows less than in proportion to a fast speed")
    ] = 0.0
    lost_over: Annotated[
        float, Number("in", 1e-6, NEVER, NEVER, "way over which the width of a fast motion is lost")
    ] = NEVER
    name: ClassVar[str] = "rate_dependence"
    state_names: ClassVar[tuple[str, ...]] = ("u", "z", "r")

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


@final
@dataclass(frozen=True)
class Asymmetry(Operator):
    """A generalised play between the identity, for loading, and a bent line above it, for unloading.

    z_k = max(u_k, min(g(u_k), z_{k-1})),  y = z
    g(u) = u + (slope_ratio_above - 1) max(u - pivot, 0) + (1 - slope_ratio_below) max(pivot - u, 0)

    The loop closes at the pivot and opens away from it: above it if unloading is steeper than loading, below it if
    flatter. Its width at two inputs is in the ratio of what the two slopes open, which is the width ratio of straight
    branches. Because both lines rise and do not cross, it has return-point memory and does not drift however often the
    loop is run through; a slope that depends on the direction alone would. Both ratios at 1 are the identity.

    Source: generalised play, Visintin, Differential Models of Hysteresis (1994), ch. III.
    """

    slope_ratio_above: Annotated[float, Number("1", 1.0, 10.0, 1.0, "slope of unloading by loading above the pivot")]
    slope_ratio_below: Annotated[float, Number("1", 0.1, 1.0, 1.0, "slope of unloading by loading below the pivot")]
    pivot: Annotated[float, Number("in", -1e4, 1e4, 0.0, "where loading and unloading meet")]
    name: ClassVar[str] = "asymmetry"
    state_names: ClassVar[tuple[str, ...]] = ("z",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        z = _between(u, x[0], p)
        return z, z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return _between(u, y, p)


def _between(u: Symbol, z: Symbol, p: Symbol) -> Symbol:
    """The state `z` moved between the two lines."""
    unloading = u + (p[0] - 1) * maximum(u - p[2], 0) + (1 - p[1]) * maximum(p[2] - u, 0)
    return maximum(u, minimum(unloading, z))


@final
@dataclass(frozen=True)
class DirectionalGain(Operator):
    """A gain that depends on the direction, which turns over gradually after a reversal.

    z_k = max(u_k - turn, min(u_k + turn, z_{k-1})),  d_k = (u_k - z_k) / turn
    y_k = u_k + gain d_k (u_k - pivot)

    The direction d lies in -1..1: -1 while unloading, 1 while loading, between them on the way. Branches then have
    slopes 1 + gain and 1 - gain, so that the loop widens (gain below zero) or narrows above the pivot and does the
    opposite below it, and does not drift however often it is run through. Gain 0 is the identity.
    """

    gain: Annotated[float, Number("1", -0.9, 0.9, 0.0, "half the difference of the slopes of loading and unloading")]
    pivot: Annotated[float, Number("in", -1e4, 1e4, 0.0, "where loading and unloading meet")]
    turn: Annotated[float, Number("in", 1e-3, 1e3, 1.0, "half the travel over which the direction turns")]
    name: ClassVar[str] = "directional_gain"
    state_names: ClassVar[tuple[str, ...]] = ("z",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        z = play(u, x[0], p[2])
        return z, u + p[0] * (u - z) / p[2] * (u - p[1])

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """Unloaded: a device at rest came down to where it is."""
        del y
        return u + p[2]

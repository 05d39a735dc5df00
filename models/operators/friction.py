"""Friction beyond a plain play: sum of stops, stick-slip, rate dependence, and asymmetry of loading and unloading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self, final

import casadi as ca

from .operator import (
    STRIBECK,
    Number,
    Operator,
    Parameter,
    Symbol,
    check_speeds,
    maximum,
    minimum,
    play,
    stribeck_factor,
)


@final
@dataclass(frozen=True)
class MaxwellSlip(Operator):
    """Friction force over a displacement: n springs on sliders in parallel with a spring and a constant force.

    r_i = spacing i (1 + stribeck exp(-|v_k| / stribeck_speed)),  v_k = (u_k - u_{k-1}) / dt,  i = 1..n
    z_i,k = max(u_k - r_i, min(u_k + r_i, z_i,k-1))
    y_k = b + k0 u_k + max(1 + growth u_k, 0) sum_i k_i (u_k - z_i,k) + viscous v_k

    A sum of stops, the dual of a Prandtl-Ishlinskii model: the force changes its sign with the motion and leads it.
    Within the bounds it is dissipative. `growth` is that of the sliders' load along the stroke.

    Attributes:
        k0: stiffness of the parallel spring, of either sign [deg/cmd].
        stiffness: of each slider's spring, k_1..k_n [deg/cmd].
        spacing: of the half-widths at which sliders break away [cmd].
        growth: of the friction with the displacement [1/cmd].
        b: constant force [deg].
        speeds: nothing, or (viscous [deg s/cmd], stribeck [1], stribeck_speed [cmd/s]) of friction that depends on the
            speed; `rate` 1 in files.

    Raises:
        ModelError: on another number of these, or a value out of bounds.

    Source: Iwan, J. Appl. Mech. 33 (1966), 893-900; the Stribeck part of the generalised Maxwell slip model, Al-Bender,
    Lampaert and Swevers, IEEE Trans. Autom. Control 50 (2005), 1883-1887.
    """

    k0: float
    stiffness: tuple[float, ...]
    spacing: float
    growth: float
    b: float
    speeds: tuple[float, ...] = ()
    name: ClassVar[str] = "maxwell_slip"
    shape: ClassVar[tuple[str, ...]] = ("elements", "rate")
    default_sizes: ClassVar[Mapping[str, int]] = {"rate": 0}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"rate": (0, 1)}

    def check_sizes(self) -> None:
        check_speeds(self.name, self.speeds, len(_NO_RATE))

    @classmethod
    def template(cls, **structure: int) -> Self:
        return cls(0.0, (0.0,) * structure["elements"], 0.0, 0.0, 0.0, _NO_RATE if structure.get("rate") else ())

    @property
    def elements(self) -> int:
        """Number n of sliders."""
        return len(self.stiffness)

    @property
    def rate(self) -> int:
        """Flag: 1 where friction depends on the speed, else 0."""
        return int(bool(self.speeds))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        slow = (
            Parameter("k0", "deg/cmd", -1e3, 1e3, "stiffness beside the sliders"),
            *(Parameter(f"k{i}", "deg/cmd", 0.0, 1e4, f"stiffness of slider {i}") for i in range(1, self.elements + 1)),
            Parameter("spacing", "cmd", 0.0, 1e3, "spacing of the half-widths"),
            Parameter("growth", "1/cmd", -1e3, 1e3, "growth of the friction with the displacement"),
            Parameter("b", "deg", -1e6, 1e6, "force at displacement 0"),
        )
        fast = (Parameter("viscous", "deg s/cmd", 0.0, 1e3, "viscous friction"), *STRIBECK)
        return (*slow, *fast) if self.rate else slow

    @property
    def states(self) -> tuple[str, ...]:
        return (*(f"z{i}" for i in range(1, self.elements + 1)), *(("u",) if self.rate else ()))

    @property
    def settling_samples(self) -> int:
        """Two samples where the first one of a hold may resemble a fast motion."""
        return 1 + self.rate

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        n = self.elements
        spacing, growth, b = p[n + 1], p[n + 2], p[n + 3]
        parallel = p[0] * u + b
        if self.rate:
            v = (u - x[n]) / dt
            spacing = spacing * stribeck_factor(ca.fabs(v), p[n + 5], p[n + 6])
            parallel = parallel + p[n + 4] * v
        z = [play(u, x[i - 1], spacing * i) for i in range(1, n + 1)]
        sliders = sum(p[i] * (u - z[i - 1]) for i in range(1, n + 1))
        return ca.vertcat(*z, *([u] if self.rate else [])), parallel + maximum(1 + growth * u, 0) * sliders

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        # All springs at the one stretch that shows force y; settling lets those slip that cannot hold it.
        n = self.elements
        stiffness = maximum(1 + p[n + 2] * u, 0) * sum(p[i] for i in range(1, n + 1))
        wanted = y - p[n + 3] - p[0] * u
        stretch = wanted * stiffness / (stiffness * stiffness + _LITTLE)
        return ca.vertcat(*([u - stretch] * n), *([u] if self.rate else []))


_NO_RATE = (0.0, 0.0, 1.0)
_LITTLE = 1e-18  # squared stiffness that avoids a division by zero


@final
@dataclass(frozen=True)
class StickSlip(Operator):
    """Play that is wide while it sticks and becomes narrower with the speed of sliding (threshold stick-slip).

    r_k = break_away exp(-v_{k-1} / stribeck_speed),  z_k = max(u_k - r_k, min(u_k + r_k, z_{k-1})),  y = z
    memory_s v' + v = |z'|  =>  v_k = s_k + exp(-dt / memory_s) (v_{k-1} - s_k),  s_k = |z_k - z_{k-1}| / dt

    A spring pulls a massless slider whose friction falls with its speed, after a memory time. Where break_away >
    stribeck_speed memory_s it breaks away with a jump d = break_away (1 - exp(-d / (stribeck_speed memory_s))), sticks
    again in a slow motion and slides at a smaller width in a fast one. Without the memory the jump, and the speed of
    steady sliding, would depend on the sample time. The constant part of friction is the play of the device. Break-away
    0 is the identity.

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


_AT_ONCE = 1e-6  # [s], decays within a sample


@final
@dataclass(frozen=True)
class RateDependence(Operator):
    """Play whose half-width grows with the speed of its input, after a memory time of the friction.

    memory_s v' + v = |u'|  =>  v_k = s_k + exp(-dt / memory_s) (v_{k-1} - s_k),  s_k = |u_k - u_{k-1}| / dt
    r_k = width_s max(1 + growth u_k, 0) v_k,  g_k = 1 + lean v_k, or 1 / (1 - lean v_k) for a lean below 0
    z_k = max(u_k - (1 - skew) r_k / g_k, min(u_k + (1 + skew) r_k g_k, z_{k-1})),  y = z

    Without memory it has no width at rest: the output reaches the input in the first sample of a hold. Friction in
    proportion to a tendon's tension grows with the command, and multiplies a pull as it divides a release, more at
    higher speed. A lean below 0 reduces a fast pull more, a lean above 0 a fast release; a skew does so at any speed.
    Width 0 is the identity.

    Source: S2 (RA-L 2024) eq. (5), the rate-dependent part of the threshold alone; the memory is that of friction in
    Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30 (1994), 1083-1138; growth, skew and lean are ours.
    """

    width_s: Annotated[float, Number("s", 0.0, 1e2, 0.0, "half-width by speed")]
    memory_s: Annotated[float, Number("s", 0.0, 1e2, 0.0, "time for which friction remembers the speed")] = 0.0
    growth: Annotated[float, Number("1/in", -1e3, 1e3, 0.0, "growth of the width with the input")] = 0.0
    skew: Annotated[float, Number("1", -1.0, 1.0, 0.0, "of the width between falling and rising input")] = 0.0
    lean: Annotated[float, Number("s/in", -1e3, 1e3, 0.0, "growth of the skew with the speed")] = 0.0
    name: ClassVar[str] = "rate_dependence"
    state_names: ClassVar[tuple[str, ...]] = ("u", "z", "v")

    @property
    def settling_samples(self) -> int:
        """Two samples, since the first one of a hold may resemble a fast motion."""
        return 2

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        speed = ca.fabs(u - x[0]) / dt
        v = speed + ca.exp(-dt / maximum(p[1], _AT_ONCE)) * (x[2] - speed)
        r = p[0] * maximum(1 + p[2] * u, 0) * v
        g = ca.if_else(p[4] >= 0, 1 + p[4] * v, 1 / (1 + ca.fabs(p[4]) * v))
        z = maximum(u - (1 - p[3]) * r / g, minimum(u + (1 + p[3]) * r * g, x[1]))
        return ca.vertcat(u, z, v), z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u, u, 0)


@final
@dataclass(frozen=True)
class DahlDrag(Operator):
    """Friction with presliding whose level grows with the speed and remains during a hold.

    s_k = |u_k - u_{k-1}| / dt = v_k + thinning v_k^2,  r_k = width_s v_k
    f_k = d r_k + (f_{k-1} - d r_k) exp(-|u_k - u_{k-1}| / (way + stretch r_k)),  d = sign(u_k - u_{k-1}),  y = u - f

    Dahl's law for a level of way + stretch r, less the level `way` that the device has at rest: the friction builds up
    and falls only with travel, over a length equal to its level. With a shear-thinning film the level grows like the
    root of a fast speed. Width 0 is the identity.

    Source: Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14 (1976), eq. (3) with exponent 1,
    integrated over a straight move, with a level that depends on the speed as in Canudas de Wit, Olsson, Astrom and
    Lischinsky, IEEE Trans. Autom. Control 40 (1995), 419-425.
    """

    width_s: Annotated[float, Number("s", 0.0, 1e2, 0.0, "growth of the level with the speed")]
    way: Annotated[float, Number("in", 1e-6, 1e4, 1.0, "over which a slow motion builds up its friction")] = 1.0
    stretch: Annotated[float, Number("1", 0.0, 1e3, 1.0, "by which that way grows with the level")] = 1.0
    thinning: Annotated[
        float, Number("s/in", 0.0, 1e3, 0.0, "by which the level grows less than in proportion to a fast speed")
    ] = 0.0
    name: ClassVar[str] = "dahl_drag"
    state_names: ClassVar[tuple[str, ...]] = ("u", "f")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        way = ca.fabs(u - x[0])
        speed = way / dt
        r = p[0] * 2 * speed / (1 + ca.sqrt(1 + 4 * p[3] * speed))
        level = ca.if_else(u >= x[0], r, -r)
        f = level + (x[1] - level) * ca.exp(-way / (p[1] + p[2] * r))
        return ca.vertcat(u, f), u - f

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u, 0)


@final
@dataclass(frozen=True)
class Asymmetry(Operator):
    """Generalised play between the identity, for loading, and a bent line above it, for unloading.

    z_k = max(u_k, min(g(u_k), z_{k-1})),  y = z
    g(u) = u + (slope_ratio_above - 1) max(u - pivot, 0) + (1 - slope_ratio_below) max(pivot - u, 0)

    The loop closes at the pivot and opens away from it: above it if unloading is steeper than loading, below it if
    flatter. Because both lines rise and do not cross, it has return-point memory and does not drift over repeated
    loops; a slope that depends on the direction alone would. Both ratios at 1 are the identity.

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
    unloading = u + (p[0] - 1) * maximum(u - p[2], 0) + (1 - p[1]) * maximum(p[2] - u, 0)
    return maximum(u, minimum(unloading, z))


@final
@dataclass(frozen=True)
class DirectionalGain(Operator):
    """Gain that depends on the direction of motion and changes gradually after a reversal.

    z_k = max(u_k - turn, min(u_k + turn, z_{k-1})),  d_k = (u_k - z_k) / turn
    y_k = u_k + gain d_k (u_k - pivot)

    The direction d is -1 while unloading, 1 while loading, and between them after a reversal. Branches then have slopes
    1 + gain and 1 - gain: the loop widens (gain below zero) or narrows above the pivot, the opposite below it, and does
    not drift over repeated loops. Gain 0 is the identity.
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
        """State after unloading: a device at rest came down to its present angle."""
        del y
        return u + p[2]

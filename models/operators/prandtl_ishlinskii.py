"""Prandtl-Ishlinskii models: rate-dependent, behind dead zones (DRDPI), and their inverses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import ClassVar, Self, final

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import PLAY_FRICTION, Operator, Parameter, Symbol, check_speeds, play, play_friction
from .static_curves import Pieces, band_parameters, check_bands, pieces_of

_LITTLE = 1e-9  # share of a divisor that avoids a division by zero


@dataclass(frozen=True)
class PlaySum(Operator):
    """Parameters shared by a Prandtl-Ishlinskii model and its inverse.

    Attributes:
        a0: weight of the command itself [deg/cmd].
        weights: weights a_1..a_n of the plays [deg/cmd].
        alpha: spacing of the thresholds [cmd].
        beta: growth of the thresholds with speed [s].
        b: offset [deg].
    """

    a0: float
    weights: tuple[float, ...]
    alpha: float
    beta: float
    b: float
    shape: ClassVar[tuple[str, ...]] = ("plays",)

    @classmethod
    def template(cls, **structure: int) -> Self:
        return cls(1.0, (0.0,) * structure["plays"], 0.0, 0.0, 0.0)

    @property
    def plays(self) -> int:
        """Number n of plays."""
        return len(self.weights)

    @property
    def numbers(self) -> tuple[float, tuple[float, ...], float, float, float]:
        """a0, the weights, alpha, beta and b."""
        return self.a0, self.weights, self.alpha, self.beta, self.b

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("a0", "deg/cmd", 1e-3, 1e3, "weight of the command"),
            *(Parameter(f"a{i}", "deg/cmd", 0.0, 1e3, f"weight of play {i}") for i in range(1, self.plays + 1)),
            Parameter("alpha", "cmd", 0.0, 1e3, "spacing of the thresholds"),
            Parameter("beta", "s", 0.0, 10.0, "growth of the thresholds with speed"),
            Parameter("b", "deg", -1e4, 1e4, "offset"),
        )

    @property
    def settling_samples(self) -> int:
        """Two samples, since the first one of a hold may resemble a fast motion."""
        return 2


@dataclass(frozen=True)
class PrandtlIshlinskii(PlaySum):
    """Weighted sum of n plays whose thresholds grow with the speed of the command.

    r_i(t) = alpha i f(t) + beta |u'(t)|,  f = 1, or that of `play_friction`
    z_i,k  = max(u_k - r_i, min(u_k + r_i, z_i,k-1)),  i = 1..n
    theta  = a0 u + sum_i a_i z_i + b

    The speed is (u_k - u_{k-1}) / dt, so that parameters do not depend on the sample rate. Weights are not negative:
    the loops are then monotone and the inverse exists.

    Attributes:
        speeds: nothing, or (stribeck [1], stribeck_speed [cmd/s], one_way [1]) of friction that depends on speed and
            direction; `rate` 1 in files.

    Raises:
        ModelError: on another number of these, or a value out of bounds.

    Source: S2 (RA-L 2024) eq. (4)-(5), after Al Janaideh, Rakheja and Su, Mechatronics 19 (2009); of the friction as
    that of `MaxwellSlip`; its direction is ours.
    """

    speeds: tuple[float, ...] = ()
    name: ClassVar[str] = "prandtl_ishlinskii"
    shape: ClassVar[tuple[str, ...]] = ("plays", "rate")
    default_sizes: ClassVar[Mapping[str, int]] = {"rate": 0}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"rate": (0, 1)}

    def check_sizes(self) -> None:
        check_speeds(self.name, self.speeds, len(PLAY_FRICTION))

    @classmethod
    def template(cls, **structure: int) -> Self:
        plain = super().template(**structure)
        return replace(plain, speeds=(0.0, 1.0, 0.0)) if structure.get("rate") else plain

    @property
    def rate(self) -> int:
        """Flag: 1 where friction depends on speed and direction, else 0."""
        return int(bool(self.speeds))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*super().parameters, *(PLAY_FRICTION if self.rate else ()))

    @property
    def states(self) -> tuple[str, ...]:
        return ("u", *(f"z{i}" for i in range(1, self.plays + 1)), *(("falling",) if self.rate else ()))

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        n = self.plays
        alpha, beta, b = p[n + 1], p[n + 2], p[n + 3]
        speed, falling = ca.fabs(u - x[0]) / dt, []
        if self.rate:
            factor, now = play_friction(u - x[0], x[n + 1], p[n + 4 :], dt)
            alpha, falling = alpha * factor, [now]
        z = [play(u, x[i], alpha * i + beta * speed) for i in range(1, n + 1)]
        theta = p[0] * u + sum(p[i] * z[i - 1] for i in range(1, n + 1)) + b
        return ca.vertcat(u, *z, *falling), theta

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        # All plays at the one state that shows y at command u; settling moves those within reach of u that are not.
        # Without weights no state makes a difference, and the division must not make one either.
        wanted = y - p[self.plays + 3] - p[0] * u
        weight = sum(p[i] for i in range(1, self.plays + 1))
        falling = [1.0] if self.rate else []  # a device at rest came down to its present angle
        return ca.vertcat(u, *([wanted / (weight + _LITTLE * (weight + p[0]))] * self.plays), *falling)

    def inverse(self) -> InversePrandtlIshlinskii:
        """Analytic inverse from angle to command.

        Raises:
            ModelError: where friction depends on speed and direction.
        """
        if self.rate:
            raise ModelError(f"{self.name}: no analytic inverse where friction depends on speed and direction")
        return InversePrandtlIshlinskii(*self.numbers)


@dataclass(frozen=True)
class InversePrandtlIshlinskii(PlaySum):
    """Analytic inverse of a Prandtl-Ishlinskii model from angle to command, itself a sum of plays.

    w_0 = 1 / a0,  w_i = 1 / sum_{j<=i} a_j - 1 / sum_{j<i} a_j
    s_i = a0 r_i + sum_{j<i} a_j (r_i - r_j),  r_i = alpha i + beta |u'|
    u   = w_0 (theta - b) + sum_i w_i Play_{s_i}[theta - b]

    The speed |u'| of the unknown command is approximated by |theta'| / sum_j a_j. The inverse is exact for beta = 0;
    the one-step inverse of a compiled model (`models/inverse`) is exact for every beta.

    Source: S2 eq. (5), after Al Janaideh and Krejci, IEEE/ASME T-Mech 18 (2013).
    """

    name: ClassVar[str] = "inverse_prandtl_ishlinskii"

    @property
    def states(self) -> tuple[str, ...]:
        return ("theta", *(f"z{i}" for i in range(1, self.plays + 1)))

    def forward(self) -> PrandtlIshlinskii:
        """The forward model of which this is the inverse."""
        return PrandtlIshlinskii(*self.numbers)

    def _sums(self, p: Symbol) -> list[Symbol]:
        sums = [p[0]]
        for i in range(1, self.plays + 1):
            sums.append(sums[-1] + p[i])
        return sums

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        n = self.plays
        alpha, beta, b = p[n + 1], p[n + 2], p[n + 3]
        sums = self._sums(p)
        speed = ca.fabs(u - x[0]) / dt / sums[n]
        wanted = u - b
        z, s = [], p[0] * beta * speed
        for i in range(1, n + 1):
            s = s + sums[i - 1] * alpha  # s_i - s_{i-1}, since r_i - r_{i-1} = alpha at every speed
            z.append(play(wanted, x[i], s))
        command = wanted / p[0] + sum((1 / sums[i] - 1 / sums[i - 1]) * z[i - 1] for i in range(1, n + 1))
        return ca.vertcat(u, *z), command

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """State of the forward plays centred on command `y`: inverse play i rests at its share of it."""
        del y
        return ca.vertcat(u, *([u - p[self.plays + 3]] * self.plays))


@dataclass(frozen=True)
class DrdpiNumbers(PlaySum):
    """Parameters shared by a DRDPI model and its inverse; those of the plays are in `PlaySum`.

    Attributes:
        slopes_below, slopes_above: slopes of the pieces below and above the middle one, outwards.
        gaps_below, gaps_above: distances between neighbouring thresholds, outwards [deg].
        offset: angle in the middle of the pieces, where v = 0 [deg].

    Raises:
        ModelError: if a value is out of bounds, or a side has another number of slopes than of gaps, or none.
    """

    slopes_below: tuple[float, ...]
    slopes_above: tuple[float, ...]
    gaps_below: tuple[float, ...]
    gaps_above: tuple[float, ...]
    offset: float
    shape: ClassVar[tuple[str, ...]] = ("plays", "below", "above")

    def check_sizes(self) -> None:
        check_bands(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        plays, below, above = (structure[name] for name in cls.shape)
        ones, zeros = ([(value,) * count for count in (below, above)] for value in (1.0, 0.0))
        return cls(*PrandtlIshlinskii.template(plays=plays).numbers, ones[0], ones[1], zeros[0], zeros[1], 0.0)

    @property
    def below(self) -> int:
        """Number of pieces below the middle one."""
        return len(self.slopes_below)

    @property
    def above(self) -> int:
        """Number of pieces above the middle one."""
        return len(self.slopes_above)

    @property
    def hysteresis(self) -> PrandtlIshlinskii:
        """The Prandtl-Ishlinskii part of the model, command to v."""
        return PrandtlIshlinskii(*self.numbers)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            *super().parameters,
            # Relative to the middle piece; a piece beyond these bounds was never reached.
            *band_parameters(self.below, self.above, 10.0, 1e3),
            Parameter("offset", "deg", -1e4, 1e4, "angle in the middle of the pieces"),
        )

    def parts(self, p: Symbol) -> tuple[Symbol, Pieces, Symbol]:
        """Parameters p (P,) of the Prandtl-Ishlinskii part (n + 4,), the dead zones' curve, the offset."""
        first = self.plays + 4
        last = first + 2 * (self.below + self.above)
        return p[:first], pieces_of(1, p[first:last], self.below, self.above), p[last]


@final
@dataclass(frozen=True)
class Drdpi(DrdpiNumbers):
    """Rate-dependent plays followed by dead zones, for loops that are asymmetric, dead or saturated at their ends.

    v     = a0 u + sum_i a_i z_i + b,  plays z_i with thresholds r_i(t) = alpha i + beta |u'(t)| as in the PI model
    theta = sum_j w_j D_{d_j}[v] + offset,  w_0 = 1

    The slope of the middle piece is one, since the weights a_i already scale the loop. Slopes and gaps give weights and
    thresholds of the dead zones, see `Pieces`; for the attributes see `DrdpiNumbers`.

    Source: ours. S1 (RA-L 2021) has the model of Shakiba et al., Mech. Syst. Signal Process. 154 (2021) 107532, whose
    equations it does not print; this is the modified Prandtl-Ishlinskii model of Kuhnen, Eur. J. Control 9 (2003), with
    the rate thresholds of Al Janaideh, Rakheja and Su, Mechatronics 19 (2009).
    """

    name: ClassVar[str] = "drdpi"

    @property
    def states(self) -> tuple[str, ...]:
        return self.hysteresis.states

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        plays, pieces, offset = self.parts(p)
        following, v = self.hysteresis.equation(x, u, plays, dt)
        return following, pieces.at(v) + offset

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        # All plays at one share of their half-widths, linear in y, as the start rule of a model file has to be: exact
        # on both branches of the loop, and between them where no kink lies between. Beyond a branch settling clamps.
        n = self.plays
        _, pieces, offset = self.parts(p)
        middle = sum(p[i] for i in range(n + 1)) * u + p[n + 3]
        half = p[n + 1] * sum(i * p[i] for i in range(1, n + 1))
        high, low = pieces.at(middle + half) + offset, pieces.at(middle - half) + offset
        share = (2 * y - high - low) / (high - low + _LITTLE * (ca.fabs(high) + ca.fabs(low)) + 1e-200)
        return ca.vertcat(u, *(u + share * p[n + 1] * i for i in range(1, n + 1)))

    def inverse(self) -> InverseDrdpi:
        """Inverse from angle to command."""
        return InverseDrdpi(*(getattr(self, field.name) for field in fields(self)))


@final
@dataclass(frozen=True)
class InverseDrdpi(DrdpiNumbers):
    """Inverse of a DRDPI model from angle to command: the inverse dead zones, then the inverse plays.

    v = D^{-1}[theta - offset],  u = PI^{-1}[v]

    Both steps with the parameters of the forward model (`DrdpiNumbers`), see `Pieces.inverse` and
    `InversePrandtlIshlinskii`. Exact for beta = 0; otherwise the command's speed is approximated by |v'| / sum_j a_j.
    The inverse plays have a closed form because the differences of thresholds are constant in time.

    Source: ours, of the parts named at `Drdpi`; inverse plays after Al Janaideh and Krejci, IEEE/ASME T-Mech 18 (2013).
    """

    name: ClassVar[str] = "inverse_drdpi"

    @property
    def states(self) -> tuple[str, ...]:
        return ("v", *self.hysteresis.inverse().states[1:])

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        plays, pieces, offset = self.parts(p)
        return self.hysteresis.inverse().equation(x, pieces.inverse().at(u - offset), plays, dt)

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """State of the forward plays centred on the command, as for the inverse plays alone."""
        plays, pieces, offset = self.parts(p)
        return self.hysteresis.inverse().at_rest(pieces.inverse().at(u - offset), y, plays)

    def forward(self) -> Drdpi:
        """The forward model of which this is the inverse."""
        return Drdpi(*(getattr(self, field.name) for field in fields(self)))

"""The rate-dependent Prandtl-Ishlinskii model, forward and its analytic inverse."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values
from .play import play


@dataclass(frozen=True)
class PrandtlIshlinskii(Operator):
    """Weighted sum of n plays whose thresholds grow with the speed of the command.

    r_i(t) = alpha i + beta |u'(t)|,  z_i,k = max(u_k - r_i, min(u_k + r_i, z_i,k-1)),  i = 1..n
    theta  = a0 u + sum_i a_i z_i + b

    The speed is (u_k - u_{k-1}) / dt per second, so that a model keeps its meaning at another sample rate.
    Weights are not negative: the loops are then monotone and the inverse exists.

    Attributes:
        a0: weight of the command itself [deg/cmd].
        weights: weights a_1..a_n of the plays [deg/cmd].
        alpha: spacing of the thresholds [cmd].
        beta: growth of the thresholds with speed [s].
        b: offset [deg].

    Source: S2 eq. (4)-(5), after Al Janaideh, Rakheja and Su, Mechatronics 19 (2009).
    """

    a0: float
    weights: tuple[float, ...]
    alpha: float
    beta: float
    b: float
    name: ClassVar[str] = "prandtl_ishlinskii"
    shape: ClassVar[tuple[str, ...]] = ("plays",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", tuple(float(w) for w in self.weights))
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        return cls(1.0, (0.0,) * structure["plays"], 0.0, 0.0, 0.0)

    @property
    def plays(self) -> int:
        """Number n of plays."""
        return len(self.weights)

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
    def states(self) -> tuple[str, ...]:
        return ("u", *(f"z{i}" for i in range(1, self.plays + 1)))

    @property
    def settling_samples(self) -> int:
        """Two: the first sample of a held command may still look like a fast motion."""
        return 2

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        n = self.plays
        alpha, beta, b = p[n + 1], p[n + 2], p[n + 3]
        speed = ca.fabs(u - x[0]) / dt
        z = [play(u, x[i], alpha * i + beta * speed) for i in range(1, n + 1)]
        theta = p[0] * u + sum(p[i] * z[i - 1] for i in range(1, n + 1)) + b
        return ca.vertcat(u, *z), theta

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        # All plays at the one state that shows y at command u; settling moves those within reach of u that are not.
        # Without weights no state makes a difference, and the division must not make one either.
        wanted = y - p[self.plays + 3] - p[0] * u
        weight = sum(p[i] for i in range(1, self.plays + 1))
        return ca.vertcat(u, *([wanted / (weight + 1e-9)] * self.plays))

    def inverse(self) -> InversePrandtlIshlinskii:
        """The analytic inverse, angle to command."""
        return InversePrandtlIshlinskii(self.a0, self.weights, self.alpha, self.beta, self.b)


@dataclass(frozen=True)
class InversePrandtlIshlinskii(Operator):
    """Angle to command by the Prandtl-Ishlinskii model's analytic inverse, itself a sum of plays.

    w_0 = 1 / a0,  w_i = 1 / sum_{j<=i} a_j - 1 / sum_{j<i} a_j
    s_i = a0 r_i + sum_{j<i} a_j (r_i - r_j),  r_i = alpha i + beta |u'|
    u   = w_0 (theta - b) + sum_i w_i Play_{s_i}[theta - b]

    The speed |u'| of the command is not known before the command is; it is taken as |theta'| / sum_j a_j. The
    inverse is exact for beta = 0; the one-step inverse of a compiled model (`models/inverse`) is exact for every beta.

    Source: S2 eq. (5), after Al Janaideh and Krejci, IEEE/ASME T-Mech 18 (2013).
    """

    a0: float
    weights: tuple[float, ...]
    alpha: float
    beta: float
    b: float
    name: ClassVar[str] = "inverse_prandtl_ishlinskii"
    shape: ClassVar[tuple[str, ...]] = ("plays",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", tuple(float(w) for w in self.weights))
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        return cls(1.0, (0.0,) * structure["plays"], 0.0, 0.0, 0.0)

    @property
    def plays(self) -> int:
        """Number n of plays."""
        return len(self.weights)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.forward().parameters

    @property
    def states(self) -> tuple[str, ...]:
        return ("theta", *(f"z{i}" for i in range(1, self.plays + 1)))

    def forward(self) -> PrandtlIshlinskii:
        """The forward model of which this is the inverse."""
        return PrandtlIshlinskii(self.a0, self.weights, self.alpha, self.beta, self.b)

    @property
    def settling_samples(self) -> int:
        """Two: the first sample of a held angle may still look like a fast motion."""
        return 2

    def _sums(self, p: Symbol) -> list[Symbol]:
        """Partial sums a0, a0 + a1, ... of the weights."""
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
        """Plays of the forward model centred on command `y`: inverse play i rests at its own share of it."""
        del y
        return ca.vertcat(u, *([u - p[self.plays + 3]] * self.plays))

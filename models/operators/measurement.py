"""Sensor noise, whose random numbers are state, and periodic disturbances."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self, final

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import Number, Operator, Parameter, Symbol, maximum

Triple = tuple[Symbol, Symbol, Symbol]
_FACTORS = (171, 172, 170)
_MODULI = (30269, 30307, 30323)
_MASK = 2**64 - 1


def draw(state: Triple) -> tuple[Triple, Symbol]:
    """Next state of the random generator and a number uniform on (0, 1).

    s_i <- a_i s_i mod m_i,  number = frac(s_1 / m_1 + s_2 / m_2 + s_3 / m_3)

    Products stay below 2^24, hence states are exact integers in single and double precision. Period: 6.95e12 draws.

    Source: Wichmann and Hill, Applied Statistics 31 (1982), algorithm AS 183, 188-190.
    """
    following = []
    total: Symbol = 0
    for s, factor, modulus in zip(state, _FACTORS, _MODULI, strict=True):
        product = factor * s
        s_next = product - modulus * ca.floor(product / modulus)
        following.append(s_next)
        total = total + s_next / modulus
    return (following[0], following[1], following[2]), total - ca.floor(total)


def start_of_seed(seed: int) -> tuple[float, float, float]:
    """Initial generator state of a seed: three integers from 1 to m_i - 1, well mixed so that near seeds are unrelated.

    Source of the mixing: splitmix64, Steele, Lea and Flood, OOPSLA 2014.
    """
    parts = []
    state = seed & _MASK
    for modulus in _MODULI:
        state = (state + 0x9E3779B97F4A7C15) & _MASK
        z = state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
        parts.append(1.0 + float((z ^ (z >> 31)) % (modulus - 1)))
    return parts[0], parts[1], parts[2]


_SHOWN = 2.0**40  # the part of a quantised value that carries the derivative is below 2^-40 of the unit
_SMALLEST = 2.0**-24  # in single precision a draw may round to zero, whose logarithm has no value


@final
@dataclass(frozen=True)
class Sensor(Operator):
    """Sensor that adds white noise and outliers, rounds, and sometimes repeats its last value.

    n   = sigma sqrt(-2 ln a) cos(2 pi b)                                      (Box and Muller, two draws)
    v   = u + n + [c < outlier_probability] outlier_size sign(1/2 - b)         (third draw)
    y_k = y_{k-1} if c >= 1 - dropout_probability, else resolution round(v / resolution)

    The draws a, b, c come from a Wichmann-Hill generator that is part of the state, see `draw`: equal seeds give equal
    noise in every backend, and each row of a batch may start at its own seed. Probabilities and sigma are per sample at
    any rate. All at 0 are the identity; a resolution of 0 does not round.

    The derivative of rounding is taken as 1 ("straight through"), so that operators before a sensor remain
    identifiable; the exact one is zero almost everywhere. Probabilities have no derivative.

    The seed is not a parameter of a fit.

    Raises:
        ModelError: if the seed is negative.
    """

    resolution: Annotated[float, Number("in", 0.0, 1e3, 0.0, "step of the sensor")]
    sigma: Annotated[float, Number("in", 0.0, 1e3, 0.0, "standard deviation of the noise")]
    outlier_probability: Annotated[float, Number("1", 0.0, 0.5, 0.0, "probability of an outlier in a sample")]
    outlier_size: Annotated[float, Number("in", 0.0, 1e3, 0.0, "distance of an outlier")]
    dropout_probability: Annotated[float, Number("1", 0.0, 0.5, 0.0, "probability of a repeated sample")]
    seed: int = 0
    name: ClassVar[str] = "sensor"
    state_names: ClassVar[tuple[str, ...]] = ("s1", "s2", "s3", "y")
    shape: ClassVar[tuple[str, ...]] = ("seed",)
    default_sizes: ClassVar[Mapping[str, int]] = {"seed": 0}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"seed": (0, 2**63 - 1)}

    def check_sizes(self) -> None:
        if self.seed < 0:
            raise ModelError(f"sensor.seed is {self.seed}, expected 0 or more")

    def reseeded(self, seed: int) -> Sensor:
        """Sensor with another seed."""
        return replace(self, seed=seed)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        first, a = draw((x[0], x[1], x[2]))
        second, b = draw(first)
        third, c = draw(second)
        noise = ca.sqrt(-2 * ca.log(maximum(a, _SMALLEST))) * ca.cos(2 * math.pi * b)
        outlier = ca.if_else(c < p[2], ca.if_else(b < 0.5, p[3], -p[3]), 0)
        shown = _rounded(u + p[1] * noise + outlier, p[0])
        y = ca.if_else(c >= 1 - p[4], x[3], shown)
        return ca.vertcat(*third, y), y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """Initial state of the seed's random numbers, with `y` as the last reading."""
        del u, p
        return ca.vertcat(*start_of_seed(self.seed), y)


def _rounded(v: Symbol, step: Symbol) -> Symbol:
    """Multiple of `step` nearest to `v`, with derivative 1 by `v`; `v` itself for step 0."""
    rounds = step > 0
    grid = ca.if_else(rounds, step, 1)
    # floor has derivative zero, so that v - floor(v 2^40) / 2^40, next to nothing in value, carries the derivative.
    carrier = v - ca.floor(v * _SHOWN) / _SHOWN
    return ca.if_else(rounds, grid * ca.floor(v / grid + 0.5) + carrier, v)


@final
@dataclass(frozen=True)
class PeriodicDisturbance(Operator):
    """Sum of harmonics with a separate clock.

    c_k = frac(c_{k-1} + frequency_hz dt),  y = u + sum_h amplitude_h sin(2 pi h c + phase_h),  h = 1..n

    The clock c counts turns, is state and starts at zero. Amplitudes at 0 are the identity.

    Attributes:
        frequency_hz: of the first harmonic [Hz].
        amplitudes: of each harmonic [in].
        phases_rad: of each harmonic [rad].

    Raises:
        ModelError: if there is no harmonic, or another number of phases than of amplitudes.
    """

    frequency_hz: float
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]
    name: ClassVar[str] = "periodic_disturbance"
    state_names: ClassVar[tuple[str, ...]] = ("c",)
    shape: ClassVar[tuple[str, ...]] = ("harmonics",)
    default_sizes: ClassVar[Mapping[str, int]] = {"harmonics": 1}

    def check_sizes(self) -> None:
        if len(self.amplitudes) != len(self.phases_rad) or not self.amplitudes:
            raise ModelError(
                f"periodic_disturbance: {len(self.amplitudes)} amplitudes and {len(self.phases_rad)} phases, "
                "expected as many, at least 1"
            )

    @classmethod
    def template(cls, **structure: int) -> Self:
        zeros = (0.0,) * structure.get("harmonics", 1)
        return cls(1.0, zeros, zeros)

    @property
    def harmonics(self) -> int:
        """Number n of harmonics."""
        return len(self.amplitudes)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        marks = [""] if self.harmonics == 1 else [f"_{h}" for h in range(1, self.harmonics + 1)]
        return (
            Parameter("frequency_hz", "Hz", 1e-3, 1e2, "frequency of the first harmonic"),
            *(Parameter(f"amplitude{m}", "in", 0.0, 1e3, "amplitude") for m in marks),
            *(Parameter(f"phase{m}_rad", "rad", -10.0, 10.0, "phase at the start of the clock") for m in marks),
        )

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        n = self.harmonics
        turns = x[0] + p[0] * dt
        turns = turns - ca.floor(turns)
        waves = (p[1 + i] * ca.sin(2 * math.pi * (i + 1) * turns + p[1 + n + i]) for i in range(n))
        return turns, u + sum(waves)

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del u, y, p
        return ca.vertcat(0)

    def resampled(self, dt_s: float, was_s: float) -> Self:
        """Disturbance with phases changed by 2 pi h f (was_s - dt_s): the clock's first step is at the first sample."""
        turn = 2 * math.pi * self.frequency_hz * (was_s - dt_s)
        phases = (math.remainder(p + h * turn, 2 * math.pi) for h, p in enumerate(self.phases_rad, 1))
        return self if dt_s == was_s else replace(self, phases_rad=tuple(phases))

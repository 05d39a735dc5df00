"""Sensor: noise, outliers, quantisation and dropouts, with randomness that is state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self, final

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import Operator, Parameter, Symbol, check_values, maximum
from .random_numbers import draw, start_of_seed

_SHOWN = 2.0**40  # the part of a quantised value that carries the derivative is below 2^-40 of the unit
_SMALLEST = 2.0**-24  # in single precision a draw may round to zero, whose logarithm has no value


@final
@dataclass(frozen=True)
class Sensor(Operator):
    """A sensor that adds white noise and outliers, rounds, and now and then repeats its last value.

    n   = sigma sqrt(-2 ln a) cos(2 pi b)                                      (Box and Muller, two draws)
    v   = u + n + [c < outlier_probability] outlier_size sign(1/2 - b)         (third draw)
    y_k = y_{k-1} if c >= 1 - dropout_probability, else resolution round(v / resolution)

    The draws a, b, c come from a Wichmann-Hill generator that is part of the state, see `random_numbers`: equal
    seeds give equal noise in every backend, and each row of a batch may start at its own seed. Probabilities and sigma
    are those of a sample, at whatever rate. All at 0 are the identity; a resolution of 0 does not round.

    The derivative of rounding is taken as 1 ("straight through"), so that what stands before a sensor remains
    identifiable; the one of the exact step is zero almost everywhere. Probabilities have no derivative.

    Attributes:
        resolution: step of the sensor [in].
        sigma: standard deviation of the noise [in].
        outlier_probability, outlier_size: of a sample [1], and how far it is off, either way [in].
        dropout_probability: of a sample that repeats the last one [1].
        seed: of the start state; not a parameter of a fit.

    Raises:
        ModelError: if the seed is negative.
    """

    resolution: float
    sigma: float
    outlier_probability: float
    outlier_size: float
    dropout_probability: float
    seed: int = 0
    name: ClassVar[str] = "sensor"
    shape: ClassVar[tuple[str, ...]] = ("seed",)
    default_sizes: ClassVar[Mapping[str, int]] = {"seed": 0}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"seed": (0, 2**63 - 1)}

    def __post_init__(self) -> None:
        check_values(self)
        if self.seed < 0:
            raise ModelError(f"sensor.seed is {self.seed}, expected 0 or more")

    @classmethod
    def template(cls, **structure: int) -> Self:
        return cls(0.0, 0.0, 0.0, 0.0, 0.0, structure.get("seed", 0))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("resolution", "in", 0.0, 1e3, "step of the sensor"),
            Parameter("sigma", "in", 0.0, 1e3, "standard deviation of the noise"),
            Parameter("outlier_probability", "1", 0.0, 0.5, "probability of an outlier in a sample"),
            Parameter("outlier_size", "in", 0.0, 1e3, "distance of an outlier"),
            Parameter("dropout_probability", "1", 0.0, 0.5, "probability of a repeated sample"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("s1", "s2", "s3", "y")

    def reseeded(self, seed: int) -> Sensor:
        """The same sensor with other random numbers."""
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
        """A fresh start of the seed's random numbers; the last value shown is `y`."""
        del u, p
        return ca.vertcat(*start_of_seed(self.seed), y)


def _rounded(v: Symbol, step: Symbol) -> Symbol:
    """The multiple of `step` next to `v`, with derivative 1 by `v`; `v` itself for step 0."""
    rounds = step > 0
    grid = ca.if_else(rounds, step, 1)
    # floor has derivative zero, so that v - floor(v 2^40) / 2^40, next to nothing in value, carries the derivative.
    carrier = v - ca.floor(v * _SHOWN) / _SHOWN
    return ca.if_else(rounds, grid * ca.floor(v / grid + 0.5) + carrier, v)

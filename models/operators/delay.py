"""Pure transport delay, fractions of a sample allowed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import Operator, Parameter, Symbol, check_values, maximum


@dataclass(frozen=True)
class Delay(Operator):
    """Transport delay of d seconds by linear interpolation between stored samples.

    y_k = sum_j h(d / dt - j) u_{k-j},  h(s) = max(0, 1 - |s|),  j = 0..n

    The hat weights keep the output differentiable in the delay, so that it can be identified.

    Attributes:
        delay_s: delay d [s], at most `samples` sample times.
        samples: length n of the store; it fixes the size of the state, so it is not a parameter of a fit.

    Raises:
        ModelError: if the store is empty or the delay out of bounds.
    """

    delay_s: float
    samples: int
    name: ClassVar[str] = "delay"
    shape: ClassVar[tuple[str, ...]] = ("samples",)

    def __post_init__(self) -> None:
        check_values(self)
        if self.samples < 1:
            raise ModelError(f"delay.samples is {self.samples}, expected at least 1")

    @classmethod
    def at_rate(cls, delay_s: float, dt: float) -> Self:
        """A delay with just the store that it needs at sample time `dt` [s]."""
        return cls(delay_s, max(1, math.ceil(delay_s / dt - 1e-9)))

    @classmethod
    def template(cls, **structure: int) -> Self:
        return cls(0.0, structure["samples"])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("delay_s", "s", 0.0, 1e2, "transport delay"),)

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(f"u{j}" for j in range(1, self.samples + 1))

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        past: Symbol = ca.vertcat(u, x)
        steps = p[0] / dt
        y = sum(maximum(0.0, 1 - ca.fabs(steps - j)) * past[j] for j in range(self.samples + 1))
        return past[: self.samples], y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.repmat(u, self.samples, 1)

    @property
    def settling_samples(self) -> int:
        """The store's length."""
        return self.samples

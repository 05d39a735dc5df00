"""Rate limit: what a drive with a top speed makes of its command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

from .operator import Operator, Parameter, Symbol, check_values, maximum, minimum


@final
@dataclass(frozen=True)
class RateLimit(Operator):
    """A follower with a top speed.

    y_k = max(y_{k-1} - top_speed dt, min(y_{k-1} + top_speed dt, u_k))

    Faster than the input ever is, it is the identity, to the last bit.

    Attributes:
        top_speed: greatest change [in/s].

    Source: Astrom and Murray, Feedback Systems (2nd ed., 2020), section 9.4, rate limiters.
    """

    top_speed: float
    name: ClassVar[str] = "rate_limit"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("top_speed", "in/s", 0.0, 1e9, "greatest change"),)

    @property
    def states(self) -> tuple[str, ...]:
        return ("y",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        y = maximum(x[0] - p[0] * dt, minimum(x[0] + p[0] * dt, u))
        return y, y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return u

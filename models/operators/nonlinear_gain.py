"""Nonlinear gain: a curved static map, of stretch, gravity or geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

from .memoryless import Memoryless
from .operator import Parameter, Symbol, check_values


@final
@dataclass(frozen=True)
class NonlinearGain(Memoryless):
    """A cubic about a centre.

    y = u + quadratic w^2 + cubic w^3,  w = u - centre

    Both coefficients at 0 are the identity. It does not force the curve to rise; where 1 + 2 quadratic w + 3 cubic w^2
    falls below zero it turns round.

    Attributes:
        quadratic: coefficient of the square [1/in].
        cubic: coefficient of the cube [1/in^2].
        centre: where the slope stays 1 [in].
    """

    quadratic: float
    cubic: float
    centre: float
    name: ClassVar[str] = "nonlinear_gain"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0, 0.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("quadratic", "1/in", -1e2, 1e2, "coefficient of the square"),
            Parameter("cubic", "1/in^2", -1e2, 1e2, "coefficient of the cube"),
            Parameter("centre", "in", -1e4, 1e4, "where the slope stays 1"),
        )

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        w = u - p[2]
        return u + (p[0] + p[1] * w) * (w * w)

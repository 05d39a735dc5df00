"""Asymmetry: loading and unloading that differ in more than a shift."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

from .operator import Operator, Parameter, Symbol, check_values, maximum, minimum


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

    Attributes:
        slope_ratio_above: slope of unloading by that of loading above the pivot [1], at least 1.
        slope_ratio_below: the same below the pivot [1], at most 1.
        pivot: where both meet [in].

    Source: generalised play, Visintin, Differential Models of Hysteresis (1994), ch. III.
    """

    slope_ratio_above: float
    slope_ratio_below: float
    pivot: float
    name: ClassVar[str] = "asymmetry"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(1.0, 1.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("slope_ratio_above", "1", 1.0, 10.0, "slope of unloading by loading above the pivot"),
            Parameter("slope_ratio_below", "1", 0.1, 1.0, "slope of unloading by loading below the pivot"),
            Parameter("pivot", "in", -1e4, 1e4, "where loading and unloading meet"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("z",)

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

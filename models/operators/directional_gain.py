"""Directional gain: loading and unloading have slopes of their own, about a point where they meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

from .operator import Operator, Parameter, Symbol, check_values
from .play import play


@final
@dataclass(frozen=True)
class DirectionalGain(Operator):
    """A gain that depends on the direction, which turns over gradually after a reversal.

    z_k = max(u_k - turn, min(u_k + turn, z_{k-1})),  d_k = (u_k - z_k) / turn
    y_k = u_k + gain d_k (u_k - pivot)

    The direction d lies in -1..1: -1 while unloading, 1 while loading, between them on the way. Branches then have
    slopes 1 + gain and 1 - gain, so that the loop widens (gain below zero) or narrows above the pivot and does the
    opposite below it, and does not drift however often it is run through. Gain 0 is the identity.

    Attributes:
        gain: half the difference of the two slopes [1].
        pivot: where the branches meet [in].
        turn: half the travel over which the direction turns [in].
    """

    gain: float
    pivot: float
    turn: float
    name: ClassVar[str] = "directional_gain"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0, 0.0, 1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("gain", "1", -0.9, 0.9, "half the difference of the slopes of loading and unloading"),
            Parameter("pivot", "in", -1e4, 1e4, "where loading and unloading meet"),
            Parameter("turn", "in", 1e-3, 1e3, "half the travel over which the direction turns"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("z",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        z = play(u, x[0], p[2])
        return z, u + p[0] * (u - z) / p[2] * (u - p[1])

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """Unloaded: a device at rest came down to where it is."""
        del y
        return u + p[2]

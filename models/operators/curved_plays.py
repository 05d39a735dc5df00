"""Sums of sharp or gradual plays, each seen through a rising curve of its own: the richest cores of `fit auto`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, maximum, minimum, play

_NARROW = 1e-9  # half-width below which a gradual play is none [cmd]


@final
@dataclass(frozen=True)
class CurvedPlays(Operator):
    """Sum of rising smooth curves of the command and of its plays.

        z_0 = u,  z_i,k = max(u_k - r_i, min(u_k + r_i, z_i,k-1)),  i = 1..n                       turn 0
                  z_i,k = u_k - s r_i (1 - e) - (u_k-1 - z_i,k-1) e,
                          s = sign(u_k - u_k-1),  e = exp(-|u_k - u_k-1| / (2 r_i))               turn 1
        theta = b + sum_i f_i(z_i),  f_i(low) = 0,  f_i' runs straight between s_ij at the knots j = 0..K

    All curves share K pieces of equal length between `low` and `high`; beyond, they go on straight. Slopes are not
    negative and those of the command itself are positive, so that the angle rises with the command and the inverse
    exists. With equal slopes in each curve it is a Prandtl-Ishlinskii model with free radii.

    A gradual play (turn 1) stands still at a reversal and takes the new direction over a travel of some r_i, as dry
    friction with presliding does: u - z is the force of a Dahl element. It is as wide as the sharp one, and z never
    falls while u rises.

    Attributes:
        slopes: s_00..s_0K, s_10..s_nK, n + 1 curves of K + 1 slopes [deg/cmd].
        b: angle where every play is at `low` [deg].
        radii: half-widths r_1..r_n of the plays [cmd].
        low, high: ends of the pieces [cmd].
        pieces: number K of pieces of each curve.
        turn: 0 for sharp plays, 1 for gradual ones.

    Raises:
        ModelError: if a value is out of bounds, or the number of slopes is not (pieces + 1) times (plays + 1).

    Source: additive operator of the Krasnosel'skii-Pokrovskii type, Krasnosel'skii, Pokrovskii, Systems with Hysteresis
    (1989), section 29. Curves: monotone splines of order 2, Ramsay, Monotone regression splines in action, Statistical
    Science 3 (1988). Gradual plays: Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14 (1976),
    eq. (3) with exponent 1, integrated over a straight move.
    """

    slopes: tuple[float, ...]
    b: float
    radii: tuple[float, ...]
    low: float
    high: float
    pieces: int
    turn: int = 0
    name: ClassVar[str] = "curved_plays"
    shape: ClassVar[tuple[str, ...]] = ("plays", "pieces", "turn")
    default_sizes: ClassVar[Mapping[str, int]] = {"turn": 0}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"turn": (0, 1)}

    @classmethod
    def template(cls, **structure: int) -> Self:
        plays, pieces = structure["plays"], structure["pieces"]
        slopes = (1.0,) * ((pieces + 1) * (plays + 1))
        return cls(slopes, 0.0, (0.0,) * plays, 0.0, 1.0, pieces, structure.get("turn", 0))

    @property
    def plays(self) -> int:
        """Number n of plays."""
        return len(self.radii)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        curves = [(i, k) for i in range(self.plays + 1) for k in range(self.pieces + 1)]
        return (
            *(
                Parameter(f"s{i}_{k}", "deg/cmd", 0.0 if i else 1e-6, 1e4, f"slope of play {i} at knot {k}")
                for i, k in curves
            ),
            Parameter("b", "deg", -1e4, 1e4, "angle where every play is at the lower end"),
            *(Parameter(f"r{i}", "cmd", 0.0, 1e4, f"half-width of play {i}") for i in range(1, self.plays + 1)),
            Parameter("low", "cmd", -1e4, 1e4, "lower end of the pieces"),
            Parameter("high", "cmd", -1e4, 1e4, "upper end of the pieces"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        plays = tuple(f"z{i}" for i in range(1, self.plays + 1))
        return (*plays, "u") if self.turn else plays

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        radii = self._radii(p)
        if self.turn:
            z = [_gradual_play(u, x[self.plays], x[i], radius) for i, radius in enumerate(radii)]
            return ca.vertcat(*z, u), self._angle([u, *z], p)
        z = [play(u, x[i], radius) for i, radius in enumerate(radii)]
        return ca.vertcat(*z), self._angle([u, *z], p)

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        # All plays at one share of their half-widths, linear in y; the mean slope of each curve stands for the curve.
        radii, knots = self._radii(p), self.pieces + 1
        means = [sum(p[i * knots + k] for k in range(knots)) / knots for i in range(1, self.plays + 1)]
        ends = knots * (self.plays + 1) + 1 + self.plays
        little = 1e-9 * p[0] * (p[ends + 1] - p[ends])  # so that nothing is divided by zero
        half = sum(mean * r for mean, r in zip(means, radii, strict=True))
        share = (y - self._angle([u] * (self.plays + 1), p)) / (half + little)
        z = [u + share * r for r in radii]
        return ca.vertcat(*z, u) if self.turn else ca.vertcat(*z)

    def _radii(self, p: Symbol) -> list[Symbol]:
        first = (self.pieces + 1) * (self.plays + 1) + 1
        return [p[first + i] for i in range(self.plays)]

    def _angle(self, plays: list[Symbol], p: Symbol) -> Symbol:
        """b and all curves, a line and parabolas from the knots on: s_0 (z - low) + sum_k c_k max(z - z_k, 0)^2."""
        knots = self.pieces + 1
        count = knots * len(plays)
        low, high = p[count + len(plays)], p[count + len(plays) + 1]
        width = (high - low) / self.pieces
        total = p[count]
        for i, z in enumerate(plays):
            slopes = [p[i * knots + k] for k in range(knots)]
            bends = [0.0, *((after - before) / (2.0 * width) for before, after in pairwise(slopes)), 0.0]
            total += slopes[0] * (z - low)
            for k in range(knots):
                total += (bends[k + 1] - bends[k]) * ca.fmax(z - (low + k * width), 0.0) ** 2
        return total


def _gradual_play(u: Symbol, before: Symbol, z: Symbol, r: Symbol) -> Symbol:
    """Next state of a gradual play of half-width `r` whose state is `z`, on a straight move from `before` to `u`."""
    behind = maximum(minimum(before - z, r), -r)  # what is guessed of a rest may be out of reach
    side = ca.if_else(u >= before, 1.0, -1.0)
    kept = ca.exp(-side * (u - before) / (2.0 * r + _NARROW))
    return u - side * r * (1.0 - kept) - behind * kept

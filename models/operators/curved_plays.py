"""A sum of plays, each seen through a rising curve of its own: the core that `fit auto` uses for asymmetric loops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .hysteresis import play
from .operator import Operator, Parameter, Symbol, check_values


@final
@dataclass(frozen=True)
class CurvedPlays(Operator):
    """Sum of rising piecewise linear curves of the command and of its plays.

        z_0 = u,  z_i,k = max(u_k - r_i, min(u_k + r_i, z_i,k-1)),  i = 1..n
        theta = b + sum_i f_i(z_i),  f_i(z) = sum_j s_ij (part of z - low that lies in piece j)

    All curves share K pieces of equal length between `low` and `high`; the first and the last one go on beyond. Slopes
    are not negative and those of the command itself are positive, so that the angle rises with the command and the
    inverse exists. With one piece it is a Prandtl-Ishlinskii model with free radii.

    Attributes:
        slopes: s_01..s_0K, s_11..s_nK, n + 1 curves of K slopes [deg/cmd].
        b: angle where every play is at `low` [deg].
        radii: half-widths r_1..r_n of the plays [cmd].
        low, high: ends of the pieces [cmd].
        pieces: number K of pieces of each curve.

    Raises:
        ModelError: if a value is out of bounds, or the number of slopes is not pieces times (plays + 1).

    Source: additive operator of the Krasnosel'skii-Pokrovskii type, Krasnosel'skii, Pokrovskii, Systems with Hysteresis
    (1989), section 29, with monotone curves as in `models.play_kernel`.
    """

    slopes: tuple[float, ...]
    b: float
    radii: tuple[float, ...]
    low: float
    high: float
    pieces: int
    name: ClassVar[str] = "curved_plays"
    shape: ClassVar[tuple[str, ...]] = ("plays", "pieces")

    def __post_init__(self) -> None:
        object.__setattr__(self, "slopes", tuple(float(v) for v in self.slopes))
        object.__setattr__(self, "radii", tuple(float(v) for v in self.radii))
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        plays, pieces = structure["plays"], structure["pieces"]
        return cls((1.0,) * (pieces * (plays + 1)), 0.0, (0.0,) * plays, 0.0, 1.0, pieces)

    @property
    def plays(self) -> int:
        """Number n of plays."""
        return len(self.radii)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        curves = [(i, k) for i in range(self.plays + 1) for k in range(1, self.pieces + 1)]
        return (
            *(
                Parameter(f"s{i}_{k}", "deg/cmd", 0.0 if i else 1e-6, 1e4, f"slope of play {i} in piece {k}")
                for i, k in curves
            ),
            Parameter("b", "deg", -1e4, 1e4, "angle where every play is at the lower end"),
            *(Parameter(f"r{i}", "cmd", 0.0, 1e4, f"half-width of play {i}") for i in range(1, self.plays + 1)),
            Parameter("low", "cmd", -1e4, 1e4, "lower end of the pieces"),
            Parameter("high", "cmd", -1e4, 1e4, "upper end of the pieces"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(f"z{i}" for i in range(1, self.plays + 1))

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        radii = self._radii(p)
        z = [play(u, x[i], radius) for i, radius in enumerate(radii)]
        return ca.vertcat(*z), self._angle([u, *z], p)

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        # All plays at one share of their half-widths, linear in y; the mean slope of each curve stands for the curve.
        radii, pieces = self._radii(p), self.pieces
        means = [sum(p[i * pieces + k] for k in range(pieces)) / pieces for i in range(1, self.plays + 1)]
        half = sum(mean * r for mean, r in zip(means, radii, strict=True))
        share = (y - self._angle([u] * (self.plays + 1), p)) / (half + 1e-9)
        return ca.vertcat(*(u + share * r for r in radii))

    def _radii(self, p: Symbol) -> list[Symbol]:
        first = self.pieces * (self.plays + 1) + 1
        return [p[first + i] for i in range(self.plays)]

    def _angle(self, plays: list[Symbol], p: Symbol) -> Symbol:
        count = self.pieces * len(plays)
        low, high = p[count + len(plays)], p[count + len(plays) + 1]
        width = (high - low) / self.pieces
        knots = [low + k * width for k in range(self.pieces + 1)]
        total = p[count]
        for i, z in enumerate(plays):
            for k in range(self.pieces):
                part = z
                if k + 1 < self.pieces:
                    part = ca.fmin(part, knots[k + 1])
                if k > 0:
                    part = ca.fmax(part, knots[k])
                total = total + p[i * self.pieces + k] * (part - knots[k])
        return total

"""Static maps: a line, dead zones in parallel, slack, contact, a curved gain."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self, final

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import Memoryless, Number, Operator, Parameter, Symbol, maximum, minimum

Side = tuple[tuple[Symbol, Symbol], ...]


@final
@dataclass(frozen=True)
class Line(Memoryless):
    """Device without hysteresis: theta = gain u + offset."""

    gain: Annotated[float, Number("deg/cmd", -1e4, 1e4, 1.0, "slope")]
    offset: Annotated[float, Number("deg", -1e4, 1e4, 0.0, "output at command 0")]
    name: ClassVar[str] = "line"

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        return p[0] * u + p[1]


@dataclass(frozen=True)
class Pieces:
    """Rising curve through the origin with straight pieces; entries are numbers or symbols.

    y = sum_j w_j D_{d_j}[x],  D_d[x] = max(x - d, 0) for d > 0,  x for d = 0,  min(x - d, 0) for d < 0
    w_0 = s_0,  w_{+-j} = s_{+-j} - s_{+-(j-1)},  d_{+-j} = +-(g_{+-1} + ... + g_{+-j})

    Weights w_j and thresholds d_j are stored as slopes s_j and gaps g_j: the inverse then needs only slopes above zero
    and nonnegative gaps, not positive partial sums of weights.

    Attributes:
        slope: slope s_0 around the origin.
        below, above: (slope, gap) of each further piece, from the origin outwards.
    """

    slope: Symbol
    below: Side
    above: Side

    def at(self, x: Symbol) -> Symbol:
        """Value of the curve at `x`."""
        y = self.slope * x
        for side, sign in ((self.below, -1), (self.above, 1)):
            threshold, last = 0, self.slope
            for slope, gap in side:
                threshold, change = threshold + sign * gap, slope - last
                beyond = minimum(x - threshold, 0) if sign < 0 else maximum(x - threshold, 0)
                y, last = y + change * beyond, slope
        return y

    def inverse(self) -> Pieces:
        """Inverse curve, which also has straight pieces: slopes 1 / s_j, gaps s_{j-1} g_j.

        In weights w'_0 = 1 / w_0,  w'_j = -w_j / (sum_{i<=j} w_i  sum_{i<j} w_i),  d'_j = sum_{i<=j} w_i (d_j - d_i).
        """
        sides = []
        for side in (self.below, self.above):
            inner = [self.slope, *(slope for slope, _ in side)]
            sides.append(tuple((1 / slope, last * gap) for last, (slope, gap) in zip(inner, side, strict=False)))
        return Pieces(1 / self.slope, *sides)


def band_parameters(below: int, above: int, steepest: float, widest: float) -> tuple[Parameter, ...]:
    """Declarations of the slopes and gaps on both sides of the middle piece, in the order of the operators' values."""
    sides = (("below", below), ("above", above))
    slopes = [
        Parameter(f"slope_{side}_{j}", "deg/deg", 1e-3, steepest, f"slope of piece {j} {side} the middle")
        for side, count in sides
        for j in range(1, count + 1)
    ]
    gaps = [
        Parameter(f"gap_{side}_{j}", "deg", 0.0, widest, f"distance from dead zone {j - 1} to {j} {side} the middle")
        for side, count in sides
        for j in range(1, count + 1)
    ]
    return (*slopes, *gaps)


def pieces_of(slope: Symbol, p: Symbol, below: int, above: int) -> Pieces:
    """Pieces from values in the order of `band_parameters`."""
    both = below + above
    return Pieces(
        slope,
        tuple((p[j], p[both + j]) for j in range(below)),
        tuple((p[below + j], p[both + below + j]) for j in range(above)),
    )


@final
@dataclass(frozen=True)
class Deadband(Memoryless):
    """Weighted sum of one-sided dead zones: bends, dead bands and saturation without memory.

    y = sum_j w_j D_{d_j}[v - centre] + offset, in slopes and gaps as `Pieces` has it; `weights` and `thresholds` give
    w_j and d_j. A piece of slope near zero is a dead band or a saturated end. Its inverse is a deadband too.

    Attributes:
        slope: slope s_0 of the middle piece.
        slopes_below, slopes_above: slopes of the pieces on either side, from the middle outwards.
        gaps_below, gaps_above: distances between neighbouring thresholds, from the middle outwards [deg].
        centre: input at which the pieces are centred [deg].
        offset: output there [deg].

    Source: Kuhnen, Eur. J. Control 9 (2003), 407-418 (one-sided dead zones and their inverse).
    """

    slope: float
    slopes_below: tuple[float, ...]
    slopes_above: tuple[float, ...]
    gaps_below: tuple[float, ...]
    gaps_above: tuple[float, ...]
    centre: float
    offset: float
    name: ClassVar[str] = "deadband"
    shape: ClassVar[tuple[str, ...]] = ("below", "above")

    def check_sizes(self) -> None:
        check_bands(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        ones, zeros = ([(value,) * structure[side] for side in cls.shape] for value in (1.0, 0.0))
        return cls(1.0, ones[0], ones[1], zeros[0], zeros[1], 0.0, 0.0)

    @property
    def below(self) -> int:
        """Number of pieces below the middle one."""
        return len(self.slopes_below)

    @property
    def above(self) -> int:
        """Number of pieces above the middle one."""
        return len(self.slopes_above)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("slope", "deg/deg", 1e-3, 1e3, "slope of the middle piece"),
            *band_parameters(self.below, self.above, 1e3, 1e6),
            Parameter("centre", "deg", -1e4, 1e4, "input at which the pieces are centred"),
            Parameter("offset", "deg", -1e4, 1e4, "output there"),
        )

    @property
    def weights(self) -> tuple[float, ...]:
        """Weights w_j, from the lowest threshold to the highest."""
        sides = [[self.slope, *slopes] for slopes in (self.slopes_below, self.slopes_above)]
        below, above = ([b - a for a, b in itertools.pairwise(side)] for side in sides)
        return (*reversed(below), self.slope, *above)

    @property
    def thresholds(self) -> tuple[float, ...]:
        """Thresholds d_j [deg], from the lowest to the highest, zero among them."""
        below, above = (itertools.accumulate(gaps) for gaps in (self.gaps_below, self.gaps_above))
        return (*(-d for d in reversed(list(below))), 0.0, *above)

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        last = 1 + 2 * (self.below + self.above)
        return pieces_of(p[0], p[1:last], self.below, self.above).at(u - p[last]) + p[last + 1]

    def inverse(self) -> Deadband:
        """Exact inverse curve.

        Raises:
            ModelError: if a slope or gap of it is out of bounds.
        """
        values = self.values
        inverse = pieces_of(self.slope, values[1:-2], self.below, self.above).inverse()
        slopes = [tuple(s for s, _ in side) for side in (inverse.below, inverse.above)]
        gaps = [tuple(g for _, g in side) for side in (inverse.below, inverse.above)]
        return Deadband(inverse.slope, slopes[0], slopes[1], gaps[0], gaps[1], self.offset, self.centre)


def check_bands(operator: Operator) -> None:
    """Check the numbers of slopes and gaps.

    Raises:
        ModelError: if a side has another number of slopes than of gaps, or none.
    """
    for side in ("below", "above"):
        slopes, gaps = (len(getattr(operator, f"{part}_{side}")) for part in ("slopes", "gaps"))
        if slopes != gaps or not slopes:
            raise ModelError(f"{operator.name}: {slopes} slopes and {gaps} gaps {side}, expected as many, at least one")


_SHARP = 1e-9  # a toe of zero is never divided by: no command lies strictly inside it


@final
@dataclass(frozen=True)
class Slack(Memoryless):
    """Dead zone at low command, with a toe where fibres or tendons become taut one after another.

    y = 0                          u <= slack - toe
    y = (u - slack + toe)^2 / (4 toe)   between, where the slope rises from 0 to 1
    y = u - slack                  u >= slack + toe

    and y = u where that is less, so that commands below zero pass. Slack 0 and toe 0 are the identity.
    """

    slack: Annotated[float, Number("in", 0.0, 1e3, 0.0, "command that is taken up before all of it arrives")]
    toe: Annotated[float, Number("in", 0.0, 1e3, 0.0, "half the travel over which it is taken up")] = 0.0
    name: ClassVar[str] = "slack"

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        over, toe = u - p[0], p[1]
        curved = (over + toe) * (over + toe) / (4 * maximum(toe, _SHARP))
        # At a tie, the branch for a rising command is active.
        loaded = ca.if_else(over >= toe, over, ca.if_else(over > -toe, curved, 0))
        return minimum(loaded, u)


@final
@dataclass(frozen=True)
class Contact(Memoryless):
    """Contact with an obstacle: beyond an angle the output rises by a share of the input only, at once or gradually.

    y = u - (1 - stiffness_ratio) d,  d = 0                      u <= angle
                                      d = (u - angle)^2 / (2 toe)   between, where its slope rises from 0 to 1
                                      d = u - angle - toe / 2    u >= angle + toe

    The ratio is the device's stiffness over that in contact: 0 is a rigid stop or saturation, 1 is the identity.
    """

    angle: Annotated[float, Number("in", -1e4, 1e4, 0.0, "where contact begins")]
    stiffness_ratio: Annotated[float, Number("1", 0.0, 1.0, 1.0, "slope beyond it")]
    toe: Annotated[float, Number("in", 0.0, 1e4, 0.0, "over which the contact stiffens")] = 0.0
    name: ClassVar[str] = "contact"

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        deep, toe = u - p[0], p[2]
        soft = deep * deep / (2 * maximum(toe, _SHARP))
        return u - (1 - p[1]) * ca.if_else(deep >= toe, maximum(deep - toe / 2, 0), ca.if_else(deep > 0, soft, 0))


@final
@dataclass(frozen=True)
class NonlinearGain(Memoryless):
    """Cubic curve about a centre.

    y = u + quadratic w^2 + cubic w^3,  w = u - centre

    Both coefficients at 0 are the identity. The curve may fall, where 1 + 2 quadratic w + 3 cubic w^2 < 0.
    """

    quadratic: Annotated[float, Number("1/in", -1e2, 1e2, 0.0, "coefficient of the square")]
    cubic: Annotated[float, Number("1/in^2", -1e2, 1e2, 0.0, "coefficient of the cube")]
    centre: Annotated[float, Number("in", -1e4, 1e4, 0.0, "where the slope stays 1")]
    name: ClassVar[str] = "nonlinear_gain"

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        w = u - p[2]
        return u + (p[0] + p[1] * w) * (w * w)

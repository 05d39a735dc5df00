"""Scans: sinusoid, triangle, and rasters of either with growing or shrinking amplitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Literal, final

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .motion import Kinematics, MotionLimits, PiecewiseCubic, ramp
from .ruckig_ import move
from .trajectory import Chain, PathTrajectory, Trajectory, inside, require_finite, require_positive


@dataclass(frozen=True)
class Cosine:
    """theta(t) = centre + A cos(2 pi f t), from one turning point to another.

    Attributes:
        centre_deg: centre [deg].
        amplitude_deg: A [deg], negative where the sweep begins at its lower turning point.
        frequency_hz: f [Hz].
        duration_s: a multiple of half a period [s].
    """

    centre_deg: float
    amplitude_deg: float
    frequency_hz: float
    duration_s: float

    def __call__(self, t: ArrayLike) -> Vec:
        """Angle [deg] at `t` [s]."""
        phase = 2 * np.pi * self.frequency_hz * inside(t, self.duration_s)
        return np.asarray(self.centre_deg + self.amplitude_deg * np.cos(phase))


@dataclass(frozen=True)
class ScanParts:
    """What every scan is made of, checked.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        centre_deg: centre of all sweeps [deg].
        amplitudes_deg: half the peak-to-peak angle of each sweep [deg].
        frequency_hz: of every sweep [Hz].
        cycles: periods per sweep, a multiple of one half.

    Raises:
        TrajectoryError: if a number is out of bounds or no amplitude is given.
    """

    start_deg: float
    centre_deg: float
    amplitudes_deg: Sequence[float]
    frequency_hz: float
    cycles: float

    def __post_init__(self) -> None:
        require_finite(start_deg=self.start_deg, centre_deg=self.centre_deg)
        require_positive(frequency_hz=self.frequency_hz, cycles=self.cycles)
        if not self.amplitudes_deg:
            raise TrajectoryError("amplitudes_deg: got none, expected at least 1")
        for k, amplitude in enumerate(self.amplitudes_deg):
            require_positive(**{f"amplitudes_deg[{k}]": amplitude})
        if (2 * self.cycles) % 1:
            raise TrajectoryError(
                f"cycles: got {self.cycles}, expected a multiple of 0.5, so that the sweep ends at a turning point"
            )

    @property
    def sides(self) -> list[tuple[float, float]]:
        """Side of the centre (+1 above, -1 below) on which each sweep begins and ends."""
        side, sides = (1.0 if self.start_deg <= self.centre_deg else -1.0), []
        for _ in self.amplitudes_deg:
            end = -side if (2 * self.cycles) % 2 else side
            sides.append((side, end))
            side = -end
        return sides

    @property
    def needed(self) -> MotionLimits:
        """Peak rates of the widest sinusoid: A w, A w^2, A w^3 with w = 2 pi f."""
        widest, omega = max(self.amplitudes_deg), 2 * np.pi * self.frequency_hz
        return MotionLimits(*(float(widest * omega**order) for order in (1, 2, 3)))


def sinusoid_sweeps(plan: ScanParts, limits: MotionLimits | None) -> Trajectory:
    """Sinusoids, each reached by a jerk-limited move that ends with the sinusoid's own acceleration.

    Velocity and acceleration are continuous from start to end; the final turning point is then held.

    Args:
        plan: the sweeps.
        limits: of the moves between; None for the peak rates of the widest sinusoid.

    Raises:
        TrajectoryError: if the limits are below the sinusoid's own rates.
    """
    limits = _covering(limits, plan.needed)
    omega = 2 * np.pi * plan.frequency_hz
    at, parts = Kinematics(plan.start_deg), list[Trajectory]()
    for amplitude, (begin, end) in zip(plan.amplitudes_deg, plan.sides, strict=True):
        turns = [
            Kinematics(plan.centre_deg + side * amplitude, 0.0, -side * float(amplitude * omega**2))
            for side in (begin, end)
        ]
        parts.append(PiecewiseCubic(move(at, turns[0], limits)))
        parts.append(Cosine(plan.centre_deg, begin * amplitude, plan.frequency_hz, plan.cycles / plan.frequency_hz))
        at = turns[1]
    return Chain(tuple(parts))


def _covering(limits: MotionLimits | None, needed: MotionLimits) -> MotionLimits:
    """The given limits if the sinusoid stays within them."""
    if limits is None:
        return needed
    for name in ("velocity_deg_s", "acceleration_deg_s2", "jerk_deg_s3"):
        if getattr(limits, name) < getattr(needed, name):
            raise TrajectoryError(
                f"limits: got {name} {getattr(limits, name):.6g}, expected at least {getattr(needed, name):.6g}, "
                "the peak rate of the widest sinusoid"
            )
    return limits


def triangle_sweeps(plan: ScanParts, limits: MotionLimits | None) -> PiecewiseCubic:
    """Legs of half a period from turning point to turning point.

    Args:
        plan: the sweeps.
        limits: every leg is a jerk-limited move from rest to rest, so that the corners are round; None for
            straight legs with sharp corners, led in at the speed of the first sweep, 4 A f.

    Raises:
        TrajectoryError: if half a period is too short for a leg within the limits.
    """
    turns = _turning_points(plan)
    leg_s = 0.5 / plan.frequency_hz
    if limits is None:
        lead_s = abs(turns[0] - plan.start_deg) / (4 * plan.amplitudes_deg[0] * plan.frequency_hz)
        legs = [ramp(plan.start_deg, turns[0], lead_s)]
        legs += [ramp(a, b, leg_s) for a, b in pairwise(turns)]
    else:
        legs = [move(Kinematics(plan.start_deg), Kinematics(turns[0]), limits)]
        legs += [move(Kinematics(a), Kinematics(b), limits, leg_s) for a, b in pairwise(turns)]
    return PiecewiseCubic(np.vstack(legs))


def _turning_points(plan: ScanParts) -> list[float]:
    """Angles of all corners, in order [deg]."""
    return [
        plan.centre_deg + amplitude * begin * (-1) ** leg
        for amplitude, (begin, _) in zip(plan.amplitudes_deg, plan.sides, strict=True)
        for leg in range(round(2 * plan.cycles) + 1)
    ]


Shape = Literal["sinusoid", "triangle"]
_BUILDERS = {"sinusoid": sinusoid_sweeps, "triangle": triangle_sweeps}


@dataclass(frozen=True)
class _Scan(PathTrajectory):
    """Sweeps of one amplitude about a centre, led in from rest at the start angle.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        centre_deg: centre [deg].
        amplitude_deg: A, half the peak-to-peak angle [deg].
        frequency_hz: f [Hz].
        cycles: periods after the lead-in, a multiple of one half.
        limits: see the kind of scan.
    """

    shape: ClassVar[Shape]
    start_deg: float
    centre_deg: float
    amplitude_deg: float
    frequency_hz: float
    cycles: float
    limits: MotionLimits | None = None

    def __post_init__(self) -> None:
        plan = ScanParts(self.start_deg, self.centre_deg, (self.amplitude_deg,), self.frequency_hz, self.cycles)
        self._follow(_BUILDERS[self.shape](plan, self.limits))


@final
@dataclass(frozen=True)
class SinusoidScan(_Scan):
    """theta(t) = centre + s A cos(2 pi f (t - t0)) for t >= t0, led in from rest at the start angle.

    The lead-in of duration t0 is a jerk-limited move to the turning point on the far side of the centre (s = +1
    where the start is at or below the centre, else -1), where it meets the sinusoid with the same velocity and
    acceleration. It overshoots neither the start nor the turning point. `limits` are those of the lead-in; None for
    the sinusoid's own peak rates A w, A w^2, A w^3 with w = 2 pi f.

    Raises:
        TrajectoryError: if a number is out of bounds, or the limits are below the sinusoid's own rates.
    """

    shape: ClassVar[Shape] = "sinusoid"


@final
@dataclass(frozen=True)
class TriangleScan(_Scan):
    """Legs of half a period between centre - A and centre + A, led in from the start angle.

    The first corner is on the far side of the centre, seen from the start. With `limits`, lead-in and legs are
    jerk-limited moves from rest to rest, which round the corners and leave amplitude and period as they are; with None
    the legs are straight, of speed 4 A f, with sharp corners.

    Raises:
        TrajectoryError: if a number is out of bounds, or half a period is too short for a leg within the limits.
    """

    shape: ClassVar[Shape] = "triangle"


@final
@dataclass(frozen=True)
class Raster(PathTrajectory):
    """Sweeps of one shape and frequency about one centre, amplitude after amplitude: nested hysteresis loops.

    Between sinusoids of different amplitude lies one jerk-limited move from turning point to turning point, with
    continuous velocity and acceleration; between triangles one leg of half a period.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        centre_deg: centre of all sweeps [deg].
        amplitudes_deg: half the peak-to-peak angle of each sweep, in order [deg].
        frequency_hz: of every sweep [Hz].
        cycles: periods per sweep, a multiple of one half.
        shape: `sinusoid` or `triangle`.
        limits: as in SinusoidScan or TriangleScan.

    Raises:
        TrajectoryError: as SinusoidScan or TriangleScan; if there is no amplitude or the shape is another.
    """

    start_deg: float
    centre_deg: float
    amplitudes_deg: Sequence[float]
    frequency_hz: float
    cycles: float
    shape: Shape = "sinusoid"
    limits: MotionLimits | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitudes_deg", tuple(float(x) for x in self.amplitudes_deg))
        if self.shape not in _BUILDERS:
            raise TrajectoryError(f"raster shape: got {self.shape!r}, expected one of {', '.join(_BUILDERS)}")
        plan = ScanParts(self.start_deg, self.centre_deg, self.amplitudes_deg, self.frequency_hz, self.cycles)
        self._follow(_BUILDERS[self.shape](plan, self.limits))

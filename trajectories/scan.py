"""Scans: sinusoid, triangle, and rasters of either with growing or shrinking amplitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .limits import MotionLimits
from .sweeps import SweepPlan, sinusoid_sweeps, triangle_sweeps
from .trajectory import Trajectory

Shape = Literal["sinusoid", "triangle"]
_BUILDERS = {"sinusoid": sinusoid_sweeps, "triangle": triangle_sweeps}


@dataclass(frozen=True)
class SinusoidScan:
    """theta(t) = centre + s A cos(2 pi f (t - t0)) for t >= t0, led in from rest at the start angle.

    The lead-in of duration t0 is a jerk-limited move to the turning point on the far side of the centre (s = +1
    where the start is at or below the centre, else -1), where it meets the sinusoid with the same velocity and
    acceleration. It overshoots neither the start nor the turning point.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        centre_deg: centre [deg].
        amplitude_deg: A, half the peak-to-peak angle [deg].
        frequency_hz: f [Hz].
        cycles: periods after the lead-in, a multiple of one half.
        limits: of the lead-in; None for the sinusoid's own peak rates A w, A w^2, A w^3 with w = 2 pi f.

    Raises:
        TrajectoryError: if a number is out of bounds, or the limits are below the sinusoid's own rates.
    """

    start_deg: float
    centre_deg: float
    amplitude_deg: float
    frequency_hz: float
    cycles: float
    limits: MotionLimits | None = None
    _path: Trajectory = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        plan = SweepPlan(self.start_deg, self.centre_deg, (self.amplitude_deg,), self.frequency_hz, self.cycles)
        object.__setattr__(self, "_path", sinusoid_sweeps(plan, self.limits))

    @property
    def duration_s(self) -> float:
        """Lead-in and cycles [s]."""
        return self._path.duration_s

    def __call__(self, t: ArrayLike) -> Vec:
        """Tip angle [deg] at `t` [s]."""
        return self._path(t)


@dataclass(frozen=True)
class TriangleScan:
    """Legs of half a period between centre - A and centre + A, led in from the start angle.

    The first corner is on the far side of the centre, seen from the start.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        centre_deg: centre [deg].
        amplitude_deg: A, half the peak-to-peak angle [deg].
        frequency_hz: f [Hz].
        cycles: periods after the lead-in, a multiple of one half.
        limits: lead-in and legs are jerk-limited moves from rest to rest, which round the corners and leave
            amplitude and period as they are; None for straight legs of speed 4 A f with sharp corners.

    Raises:
        TrajectoryError: if a number is out of bounds, or half a period is too short for a leg within the limits.
    """

    start_deg: float
    centre_deg: float
    amplitude_deg: float
    frequency_hz: float
    cycles: float
    limits: MotionLimits | None = None
    _path: Trajectory = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        plan = SweepPlan(self.start_deg, self.centre_deg, (self.amplitude_deg,), self.frequency_hz, self.cycles)
        object.__setattr__(self, "_path", triangle_sweeps(plan, self.limits))

    @property
    def duration_s(self) -> float:
        """Lead-in and cycles [s]."""
        return self._path.duration_s

    def __call__(self, t: ArrayLike) -> Vec:
        """Tip angle [deg] at `t` [s]."""
        return self._path(t)


@dataclass(frozen=True)
class Raster:
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
    _path: Trajectory = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitudes_deg", tuple(float(x) for x in self.amplitudes_deg))
        if self.shape not in _BUILDERS:
            raise TrajectoryError(f"raster shape: got {self.shape!r}, expected one of {', '.join(_BUILDERS)}")
        plan = SweepPlan(self.start_deg, self.centre_deg, self.amplitudes_deg, self.frequency_hz, self.cycles)
        object.__setattr__(self, "_path", _BUILDERS[self.shape](plan, self.limits))

    @property
    def duration_s(self) -> float:
        """All lead-ins and cycles [s]."""
        return self._path.duration_s

    def __call__(self, t: ArrayLike) -> Vec:
        """Tip angle [deg] at `t` [s]."""
        return self._path(t)

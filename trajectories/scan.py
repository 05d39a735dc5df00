"""Scans: sinusoid, triangle, and rasters of either with increasing or decreasing amplitude."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hystmpc.trials.config import Positive
from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .motion import Kinematics, MotionLimits, PathMotion, PiecewiseCubic, ramp
from .ruckig_ import move
from .trajectory import Trajectory, TrajectoryChain, inside

Shape = Literal["sinusoid", "triangle"]


@dataclass(frozen=True)
class Cosine:
    """Sinusoidal sweep theta(t) = centre + A cos(2 pi f t), from one turning point to another.

    Attributes:
        centre_deg: mean angle [deg].
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


class Scan(PathMotion):
    """Base of the scans: sweeps about one centre, after a lead-in from rest at the start angle.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        centre_deg: centre of the sweeps [deg].
        frequency_hz: of every sweep [Hz].
        cycles: periods of each sweep, a multiple of 0.5.
        limits: of the lead-in, and of a triangle's legs; null for a sinusoid's own rates, or sharp corners.
    """

    start_deg: float
    centre_deg: float
    frequency_hz: Positive
    cycles: float = Field(gt=0, multiple_of=0.5)
    limits: MotionLimits | None = None

    @property
    @abstractmethod
    def sweeps(self) -> tuple[Shape, tuple[float, ...]]:
        """Shape of all sweeps, and half the peak-to-peak angle of each [deg]."""

    @cached_property
    def path(self) -> Trajectory:
        shape, amplitudes = self.sweeps
        return self._sinusoids(amplitudes) if shape == "sinusoid" else self._triangles(amplitudes)

    def _sides(self, amplitudes: tuple[float, ...]) -> list[tuple[float, float]]:
        """Side of the centre (+1 above, -1 below) on which each sweep begins and ends."""
        side, sides = (1.0 if self.start_deg <= self.centre_deg else -1.0), []
        for _ in amplitudes:
            end = -side if (2 * self.cycles) % 2 else side
            sides.append((side, end))
            side = -end
        return sides

    def _sinusoids(self, amplitudes: tuple[float, ...]) -> TrajectoryChain:
        """Sinusoids, each preceded by a jerk-limited move that ends with the sinusoid's initial acceleration."""
        omega = 2 * np.pi * self.frequency_hz
        limits = self._covering(*(float(max(amplitudes) * omega**order) for order in (1, 2, 3)))
        at, parts = Kinematics(self.start_deg), list[Trajectory]()
        for amplitude, (begin, end) in zip(amplitudes, self._sides(amplitudes), strict=True):
            turns = [
                Kinematics(self.centre_deg + side * amplitude, 0.0, -side * float(amplitude * omega**2))
                for side in (begin, end)
            ]
            parts.append(PiecewiseCubic(move(at, turns[0], limits)))
            parts.append(Cosine(self.centre_deg, begin * amplitude, self.frequency_hz, self.cycles / self.frequency_hz))
            at = turns[1]
        return TrajectoryChain(tuple(parts))

    def _covering(self, *needed: float) -> MotionLimits:
        """Limits checked against the peak rates of the widest sinusoid; these rates if there are no limits."""
        rates = dict(zip(MotionLimits.model_fields, needed, strict=True))
        if self.limits is None:
            return MotionLimits(**rates)
        for name, rate in rates.items():
            if getattr(self.limits, name) < rate:
                raise TrajectoryError(
                    f"limits: got {name} {getattr(self.limits, name):.6g}, expected at least {rate:.6g}, "
                    "the peak rate of the widest sinusoid"
                )
        return self.limits

    def _triangles(self, amplitudes: tuple[float, ...]) -> PiecewiseCubic:
        """Legs of half a period: jerk-limited moves from rest to rest, or straight without limits."""
        turns = [
            self.centre_deg + amplitude * begin * (-1) ** leg
            for amplitude, (begin, _) in zip(amplitudes, self._sides(amplitudes), strict=True)
            for leg in range(round(2 * self.cycles) + 1)
        ]
        leg_s = 0.5 / self.frequency_hz
        if self.limits is None:
            lead_s = abs(turns[0] - self.start_deg) / (4 * amplitudes[0] * self.frequency_hz)
            legs = [ramp(self.start_deg, turns[0], lead_s)]
            legs += [ramp(a, b, leg_s) for a, b in pairwise(turns)]
        else:
            legs = [move(Kinematics(self.start_deg), Kinematics(turns[0]), self.limits)]
            legs += [move(Kinematics(a), Kinematics(b), self.limits, leg_s) for a, b in pairwise(turns)]
        return PiecewiseCubic(np.vstack(legs))


class SinusoidScan(Scan):
    """Sinusoidal scan theta(t) = centre + s A cos(2 pi f (t - t0)) for t >= t0, led in from rest at the start angle.

    The lead-in of duration t0 is a jerk-limited move to the turning point on the far side of the centre (s = +1
    where the start is at or below the centre, else -1), where it meets the sinusoid with the same velocity and
    acceleration. It overshoots neither the start nor the turning point. `limits` are those of the lead-in; None for
    the sinusoid's own peak rates A w, A w^2, A w^3 with w = 2 pi f.

    Attributes:
        amplitude_deg: half the peak-to-peak angle [deg].

    Raises:
        TrajectoryError: if a number is out of bounds, or the limits are below the sinusoid's own rates.
    """

    by_position = ("start_deg", "centre_deg", "amplitude_deg", "frequency_hz", "cycles", "limits")
    kind: Literal["scan_sinusoid"] = "scan_sinusoid"
    amplitude_deg: Positive

    @property
    def sweeps(self) -> tuple[Shape, tuple[float, ...]]:
        """Shape and half peak-to-peak angle of the sinusoid [deg]."""
        return "sinusoid", (self.amplitude_deg,)


class TriangleScan(Scan):
    """Triangular scan: legs of half a period between centre - A and centre + A, led in from the start angle.

    The first corner is on the far side of the centre, seen from the start. With `limits`, lead-in and legs are
    jerk-limited moves from rest to rest, which round the corners and leave amplitude and period as they are; with None
    the legs are straight, of speed 4 A f, with sharp corners.

    Attributes:
        amplitude_deg: half the peak-to-peak angle [deg].

    Raises:
        TrajectoryError: if a number is out of bounds, or half a period is too short for a leg within the limits.
    """

    by_position = SinusoidScan.by_position
    kind: Literal["scan_triangle"] = "scan_triangle"
    amplitude_deg: Positive

    @property
    def sweeps(self) -> tuple[Shape, tuple[float, ...]]:
        """Shape and half peak-to-peak angle of the triangle [deg]."""
        return "triangle", (self.amplitude_deg,)


class Raster(Scan):
    """Raster scan: sweeps of one shape and frequency with changing amplitude, for nested hysteresis loops.

    Between sinusoids of different amplitude lies one jerk-limited move from turning point to turning point, with
    continuous velocity and acceleration; between triangles one leg of half a period.

    Attributes:
        amplitudes_deg: half the peak-to-peak angle of each sweep, in order [deg].
        shape: of every sweep.

    Raises:
        TrajectoryError: as SinusoidScan or TriangleScan; if there is no amplitude or the shape is another.
    """

    by_position = ("start_deg", "centre_deg", "amplitudes_deg", "frequency_hz", "cycles", "shape", "limits")
    kind: Literal["raster"] = "raster"
    amplitudes_deg: tuple[Positive, ...] = Field(min_length=1)
    shape: Shape = "sinusoid"

    @property
    def sweeps(self) -> tuple[Shape, tuple[float, ...]]:
        """Shape and half peak-to-peak angle of each sweep [deg], in order."""
        return self.shape, self.amplitudes_deg

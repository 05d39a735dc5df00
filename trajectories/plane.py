"""Motions in the plane of both bending angles: circle, spiral, Lissajous figure, raster, star, ring of targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.tip import BendShape, angles_from_tip_aside
from hystmpc.trials.types import Vec

from .motion import Kinematics, MotionLimits, PiecewiseCubic, hold
from .ruckig_ import move
from .trajectory import Trajectory, inside

Point = tuple[float, float]
_AXES = 2
_LOOKED_AT = 2000  # points of a motion in mm whose reach is looked at
_APPROACH_HOLD_S, _ROUNDING = 1.0, 1e-9


@final
@dataclass(frozen=True, eq=False)
class PlaneMotion:
    """Two angles over time, `motion(t)` -> (..., 2) [deg]; the ends hold before and after.

    Attributes:
        function: angles (..., 2) [deg] at times (...) from 0 to the end [s].
        duration_s: time from start to end [s].
    """

    function: Callable[[Vec], Vec]
    duration_s: float

    def __call__(self, t: ArrayLike) -> Vec:
        """Angles (..., 2) [deg] at `t` [s]."""
        return self.function(inside(t, self.duration_s))


def through_points(points: Sequence[Point], hold_s: float = 0.5, limits: MotionLimits | None = None) -> PlaneMotion:
    """Straight moves from point to point with a rest at each.

    Args:
        points: angles (x, y) [deg], the first of them the start.
        hold_s: rest at every point [s].
        limits: along each line; the default ones where left out.

    Raises:
        TrajectoryError: if there are fewer than two points, a number is not finite, or no motion is found.
    """
    corners = np.array(_finite(points, "points"))
    if len(corners) < 2 or not hold_s >= 0:
        raise TrajectoryError(f"points: got {len(corners)} and holds of {hold_s} s, expected at least two, holds >= 0")
    ways = np.hypot(*np.diff(corners, axis=0).T)
    at, pieces = np.concatenate([[0.0], np.cumsum(ways)]), [hold(0.0, hold_s)]
    for before, after in pairwise(at.tolist()):
        pieces += [move(Kinematics(before), Kinematics(after), limits or MotionLimits()), hold(after, hold_s)]
    along = PiecewiseCubic(np.vstack(pieces))
    apart = np.concatenate([[True], ways > 0])
    at, corners = at[apart], corners[apart]

    def angles(t: Vec) -> Vec:
        way = along(t)
        return np.stack([np.interp(way, at, corners[:, axis]) for axis in range(_AXES)], axis=-1)

    return PlaneMotion(angles, along.duration_s)


def circle(centre: Point, radius_deg: float, period_s: float, turns: float = 1.0) -> PlaneMotion:
    """Circle from and to rest: centre + r (cos 2 pi s, sin 2 pi s), s from 0 to `turns`, one turn a period between.

    Raises:
        TrajectoryError: if a number is not finite, or radius, period or turns are not positive.
    """
    c, s = _finite([centre], "centre")[0], _progress(turns, period_s, radius_deg)

    def angles(t: Vec) -> Vec:
        phase = 2 * np.pi * s(t)
        return np.stack([c[0] + radius_deg * np.cos(phase), c[1] + radius_deg * np.sin(phase)], axis=-1)

    return PlaneMotion(angles, s.duration_s)


def spiral(centre: Point, radius_deg: float, period_s: float, turns: float = 3.0) -> PlaneMotion:
    """Spiral from the centre outwards to `radius_deg`, from and to rest; arguments and errors as of `circle`."""
    c, s = _finite([centre], "centre")[0], _progress(turns, period_s, radius_deg)

    def angles(t: Vec) -> Vec:
        along = s(t)
        r, phase = radius_deg * along / turns, 2 * np.pi * along
        return np.stack([c[0] + r * np.cos(phase), c[1] + r * np.sin(phase)], axis=-1)

    return PlaneMotion(angles, s.duration_s)


def lissajous(
    centre: Point, sizes_deg: Point, ratio: tuple[int, int], period_s: float, turns: float = 1.0
) -> PlaneMotion:
    """Lissajous figure from and to rest: centre + (A sin 2 pi a s, B sin 2 pi b s), (a, b) = `ratio`.

    Raises:
        TrajectoryError: as `circle`.
    """
    c, (a, b), (wide, high) = _finite([centre], "centre")[0], ratio, sizes_deg
    s = _progress(turns, period_s, min(abs(wide), abs(high)))

    def angles(t: Vec) -> Vec:
        phase = 2 * np.pi * s(t)
        return np.stack([c[0] + wide * np.sin(a * phase), c[1] + high * np.sin(b * phase)], axis=-1)

    return PlaneMotion(angles, s.duration_s)


def star(
    centre: Point, radius_deg: float, tips: int = 5, hold_s: float = 0.5, limits: MotionLimits | None = None
) -> PlaneMotion:
    """Star of straight lines through `tips` points, every second one next; errors as of `through_points`."""
    return through_points(_around(centre, radius_deg, tips, 2, tips + 1), hold_s, limits)


def ring(
    centre: Point, radius_deg: float, targets: int = 8, hold_s: float = 1.0, limits: MotionLimits | None = None
) -> PlaneMotion:
    """Targets on a ring, each reached from the centre and left to it; errors as of `through_points`."""
    points = [centre]
    for target in _around(centre, radius_deg, targets, 1, targets):
        points += [target, centre]
    return through_points(points, hold_s, limits)


def raster(
    corner: Point, far_corner: Point, rows: int = 4, hold_s: float = 0.2, limits: MotionLimits | None = None
) -> PlaneMotion:
    """Rows along x between two corners, to and fro; errors as of `through_points`."""
    heights = np.linspace(corner[1], far_corner[1], max(rows, 1)).tolist()
    points: list[Point] = []
    for row, height in enumerate(heights):
        ends = (corner[0], far_corner[0]) if row % 2 == 0 else (far_corner[0], corner[0])
        points += [(ends[0], height), (ends[1], height)]
    return through_points(points, hold_s, limits)


def through_tips(motion_mm: PlaneMotion, length_mm: float | BendShape) -> PlaneMotion:
    """Angles whose tip follows a motion of x and y in mm; see `trials.tip`.

    Args:
        motion_mm: any motion of this module, made of numbers in mm: `through_tips(spiral((0, 0), 12.0, 4.0), 60.0)`.
        length_mm: of the bending part, which has constant curvature; or another shape, such as a fitted `TipMap`.

    Raises:
        TrajectoryError: if the motion leaves the reach, .7246 of the length aside, or the length is not positive.
    """
    if isinstance(length_mm, float | int) and not (np.isfinite(length_mm) and length_mm > 0):
        raise TrajectoryError(f"length_mm: got {length_mm}, expected a positive number")
    angles_from_tip_aside(motion_mm(np.linspace(0.0, motion_mm.duration_s, _LOOKED_AT)), length_mm)
    return PlaneMotion(lambda t: angles_from_tip_aside(motion_mm(t), length_mm), motion_mm.duration_s)


def after_approach(
    motion: PlaneMotion, rest_deg: Point, dt_s: float, limits: MotionLimits | None = None
) -> PlaneMotion:
    """Motion behind a straight move from a rest to its start, with holds; the move lasts whole samples.

    Raises:
        TrajectoryError: if no move is found.
    """
    start: Point = (float(motion(0.0)[0]), float(motion(0.0)[1]))
    lead = through_points([rest_deg, start], _APPROACH_HOLD_S, limits)
    lead_s = float(np.ceil(lead.duration_s / dt_s - _ROUNDING)) * dt_s

    def angles(t: Vec) -> Vec:
        return np.where((t < lead_s)[..., None], lead(t), motion(t - lead_s))

    return PlaneMotion(angles, lead_s + motion.duration_s)


def _around(centre: Point, radius: float, count: int, stride: int, visited: int) -> list[Point]:
    if count < 3:
        raise TrajectoryError(f"points around a centre: got {count}, expected at least three")
    phases = [np.pi / 2 + 2 * np.pi * stride * k / count for k in range(visited)]
    return [(centre[0] + radius * float(np.cos(p)), centre[1] + radius * float(np.sin(p))) for p in phases]


def _progress(turns: float, period_s: float, size: float) -> Trajectory:
    """Turns over time, from rest to rest, at one turn a period in between; a quarter of a period to get there."""
    if not (np.isfinite([turns, period_s, size]).all() and turns > 0 and period_s > 0 and size > 0):
        raise TrajectoryError(f"got {turns} turns of {period_s} s and size {size} deg, expected positive numbers")
    speed = 1 / period_s
    limits = MotionLimits(
        velocity_deg_s=speed, acceleration_deg_s2=8 * speed / period_s, jerk_deg_s3=64 * speed / period_s**2
    )
    return PiecewiseCubic(move(Kinematics(0.0), Kinematics(turns), limits))


def _finite(points: Sequence[Point], what: str) -> list[Point]:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != _AXES or not np.isfinite(array).all():
        raise TrajectoryError(f"{what}: got shape {array.shape}, expected finite angles (x, y) [deg]")
    return [(float(x), float(y)) for x, y in array]

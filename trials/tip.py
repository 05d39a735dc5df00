"""Tip of a bend of constant curvature: from two bending angles to a position in mm, and back.

    bend = |(theta_x, theta_y)|,  plane = atan2(theta_y, theta_x)
    x, y = L (1 - cos bend) / bend (cos plane, sin plane),   z = L sin(bend) / bend

The bending part is an arc of length L that begins at the origin along z. The equations are those of arc parameters in
Webster and Jones, Int. J. Robotics Research 29 (2010), with curvature bend / L. A catheter is not exactly an arc: any
other `BendShape` may stand in the place of L, such as the quadratic map of S2 (RA-L 2024), `hystmpc.models.maps`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .errors import LogError, TrajectoryError
from .types import Vec

FARTHEST_DEG = 133.56347335327857
"""Bend at which the tip is farthest from the axis z; a greater one brings it back."""

_HALVINGS = 50


class BendShape(Protocol):
    """Tip of a bending part in the plane of its bend."""

    @property
    def farthest_deg(self) -> float:
        """Bend up to which the tip goes farther aside [deg]."""
        ...

    def aside(self, bend_deg: ArrayLike) -> Vec:
        """Distance of the tip from the axis z [mm] by the bend [deg]; zero without one."""
        ...

    def along(self, bend_deg: ArrayLike) -> Vec:
        """Coordinate z of the tip [mm] by the bend [deg]."""
        ...


def angles_from_bend(bend_deg: ArrayLike, plane_deg: ArrayLike) -> Vec:
    """Bending angles (..., 2) [deg] = bend (cos plane, sin plane), of a bend and its plane [deg]."""
    bend, plane = np.asarray(bend_deg, dtype=np.float64), np.deg2rad(np.asarray(plane_deg, dtype=np.float64))
    return np.stack([bend * np.cos(plane), bend * np.sin(plane)], axis=-1)


def tip_from_angles(angles_deg: ArrayLike, length_mm: float | BendShape) -> Vec:
    """Tip x, y, z (..., 3) [mm] of bending angles (..., 2) [deg].

    Args:
        length_mm: of the bending part, as an arc; or another shape.
    """
    shape = _Arc(length_mm) if isinstance(length_mm, float | int) else length_mm
    angles = np.asarray(angles_deg, dtype=np.float64)
    bend, plane = np.hypot(angles[..., 0], angles[..., 1]), np.arctan2(angles[..., 1], angles[..., 0])
    aside = shape.aside(bend)
    return np.stack([aside * np.cos(plane), aside * np.sin(plane), shape.along(bend)], axis=-1)


def angles_from_tip(tip_mm: ArrayLike) -> Vec:
    """Bending angles (..., 2) [deg] of a tip x, y, z (..., 3) [mm] seen from the base; no length is needed.

        bend = 2 atan2(|(x, y)|, z)

    Raises:
        LogError: if a tip is behind its base on the axis z, where the plane of the bend is unknown.
    """
    x, y, z = np.moveaxis(np.asarray(tip_mm, dtype=np.float64), -1, 0)
    aside = np.hypot(x, y)
    if np.any((aside == 0) & (z <= 0)):
        raise LogError("tip: got x = y = 0 with z <= 0, expected a tip in front of its base or beside it [mm]")
    bend = np.rad2deg(2 * np.arctan2(aside, z))
    return angles_from_bend(bend, np.rad2deg(np.arctan2(y, x)))


def angles_from_tip_aside(tip_mm: ArrayLike, length_mm: float | BendShape) -> Vec:
    """Bending angles (..., 2) [deg] whose tip has these x, y (..., 2) [mm], with a bend of at most 133.6 deg.

    Args:
        length_mm: of the bending part, as an arc; or another shape, with a bend of at most its `farthest_deg`.

    Raises:
        TrajectoryError: if a tip is out of reach (of an arc: farther from the axis than .7246 of the length), or no
            number.
    """
    shape = _Arc(length_mm) if isinstance(length_mm, float | int) else length_mm
    tip = np.asarray(tip_mm, dtype=np.float64)
    aside, reach = np.hypot(tip[..., 0], tip[..., 1]), float(shape.aside(shape.farthest_deg))
    if not np.all(aside <= reach):
        worst = float(np.max(aside)) if np.all(np.isfinite(aside)) else float("nan")
        raise TrajectoryError(
            f"tip: got {worst:.4g} mm from the axis, expected at most {reach:.4g} mm, the reach of {shape}"
        )
    low, high = np.zeros(aside.shape), np.full(aside.shape, shape.farthest_deg)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        beyond = shape.aside(middle) > aside
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return angles_from_bend(0.5 * (low + high), np.rad2deg(np.arctan2(tip[..., 1], tip[..., 0])))


@dataclass(frozen=True)
class _Arc:
    length_mm: float

    farthest_deg = FARTHEST_DEG

    def __str__(self) -> str:
        return f"a bending part of {self.length_mm:.4g} mm"

    def aside(self, bend_deg: ArrayLike) -> Vec:
        bend = np.deg2rad(bend_deg)
        return np.asarray(0.5 * bend * np.sinc(bend / (2 * np.pi)) ** 2 * self.length_mm)

    def along(self, bend_deg: ArrayLike) -> Vec:
        return np.asarray(self.length_mm * np.sinc(np.deg2rad(bend_deg) / np.pi))

"""Tip of a bend of constant curvature: from two bending angles to a position in mm, and back.

    bend = |(theta_x, theta_y)|,  plane = atan2(theta_y, theta_x)
    x, y = L (1 - cos bend) / bend (cos plane, sin plane),   z = L sin(bend) / bend

The bending part is an arc of length L that begins at the origin along z. The equations are those of arc parameters in
Webster and Jones, Int. J. Robotics Research 29 (2010), with curvature bend / L. A catheter is not exactly an arc: for
one angle `hystmpc.models.maps` has the quadratic map that S2 (RA-L 2024) measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .errors import LogError, TrajectoryError
from .types import Vec

FARTHEST_DEG = 133.56347335327857
"""Bend at which the tip is farthest from the axis z; a greater one brings it back."""

_FARTHEST = (1 - np.cos(np.deg2rad(FARTHEST_DEG))) / np.deg2rad(FARTHEST_DEG)  # .7246 of the length
_HALVINGS = 50


def angles_from_bend(bend_deg: ArrayLike, plane_deg: ArrayLike) -> Vec:
    """Bending angles (..., 2) [deg] = bend (cos plane, sin plane), of a bend and its plane [deg]."""
    bend, plane = np.asarray(bend_deg, dtype=np.float64), np.deg2rad(np.asarray(plane_deg, dtype=np.float64))
    return np.stack([bend * np.cos(plane), bend * np.sin(plane)], axis=-1)


def tip_from_angles(angles_deg: ArrayLike, length_mm: float) -> Vec:
    """Tip x, y, z (..., 3) [mm] of bending angles (..., 2) [deg] and the length of the bending part [mm]."""
    angles = np.deg2rad(np.asarray(angles_deg, dtype=np.float64))
    bend = np.hypot(angles[..., 0], angles[..., 1])
    aside = 0.5 * length_mm * np.sinc(bend / (2 * np.pi)) ** 2  # (1 - cos b) / b^2, without its gap at zero
    return np.stack([aside * angles[..., 0], aside * angles[..., 1], length_mm * np.sinc(bend / np.pi)], axis=-1)


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


def angles_from_tip_aside(tip_mm: ArrayLike, length_mm: float) -> Vec:
    """Bending angles (..., 2) [deg] whose tip has these x, y (..., 2) [mm], with a bend of at most 133.6 deg.

    Raises:
        TrajectoryError: if a tip is farther from the axis than .7246 of the length, or no number.
    """
    tip = np.asarray(tip_mm, dtype=np.float64)
    aside, reach = np.hypot(tip[..., 0], tip[..., 1]), float(_FARTHEST * length_mm)
    if not np.all(aside <= reach):
        worst = float(np.max(aside)) if np.all(np.isfinite(aside)) else float("nan")
        raise TrajectoryError(
            f"tip: got {worst:.4g} mm from the axis, expected at most {reach:.4g} mm, the reach of a bending part of "
            f"{length_mm:.4g} mm"
        )
    low, high = np.zeros(aside.shape), np.full(aside.shape, np.deg2rad(FARTHEST_DEG))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        beyond = 0.5 * middle * np.sinc(middle / (2 * np.pi)) ** 2 * length_mm > aside
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return angles_from_bend(np.rad2deg(0.5 * (low + high)), np.rad2deg(np.arctan2(tip[..., 1], tip[..., 0])))

"""A bending segment of constant curvature, with a ray along the tip's tangent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Mat, Vec

_SERIES_RAD = 1e-2  # below it the closed form of dz/dtheta loses digits; the next term of the series is 1e-15


@dataclass(frozen=True)
class Segment:
    """A segment of length L that bends by theta in a plane; r is across and z along the straight segment.

    tip     (r, z) = L ( (1 - cos theta) / theta, sin theta / theta ),  (0, L) where theta = 0
    tangent (r, z) = ( sin theta, cos theta )
    point   at distance d along the tangent = tip + d tangent

    Quotients are written with sinc, which needs no case at theta = 0: (1 - cos t) / t = sin(t/2) sinc(t/2).
    Source: constant curvature model, S1 section II-B.

    Attributes:
        length_mm: L [mm].

    Raises:
        ConfigError: if the length is not finite and positive.
    """

    length_mm: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.length_mm) and self.length_mm > 0):
            raise ConfigError(f"segment: got length {self.length_mm} mm, expected a finite number > 0")

    def tip(self, theta_deg: ArrayLike) -> Mat:
        """Tip (..., 2) [mm] at bending angles [deg]."""
        t = np.radians(np.asarray(theta_deg, float))
        return self.length_mm * np.stack([np.sin(t / 2) * _sinc(t / 2), _sinc(t)], axis=-1)

    def tangent(self, theta_deg: ArrayLike) -> Mat:
        """Unit vector (..., 2) that the tip looks along."""
        t = np.radians(np.asarray(theta_deg, float))
        return np.stack([np.sin(t), np.cos(t)], axis=-1)

    def point(self, theta_deg: ArrayLike, distance_mm: ArrayLike) -> Mat:
        """Point (..., 2) at a distance along the tangent [mm]: polar to Cartesian."""
        return self.tip(theta_deg) + np.asarray(distance_mm, float)[..., None] * self.tangent(theta_deg)

    def lever(self, theta_deg: ArrayLike, distance_mm: ArrayLike) -> Vec:
        """Displacement of that point by an angle error at the same distance, |d point / d theta| [mm/deg].

        dr/dtheta = L (sinc t - sinc(t/2)^2 / 2) + d cos t;  dz/dtheta = L (cos t - sinc t) / t - d sin t
        """
        t = np.radians(np.asarray(theta_deg, float))
        d = np.asarray(distance_mm, float)
        near = np.abs(t) < _SERIES_RAD
        safe = np.where(near, 1.0, t)
        drop = np.where(near, -t / 3 + t**3 / 30 - t**5 / 840, (np.cos(safe) - _sinc(safe)) / safe)
        across = self.length_mm * (_sinc(t) - _sinc(t / 2) ** 2 / 2) + d * np.cos(t)
        along = self.length_mm * drop - d * np.sin(t)
        return np.radians(np.hypot(across, along))


def rotated(points: Mat, rotation_deg: ArrayLike) -> Mat:
    """Points (..., 2) of the bending plane in space (..., 3), turned about the axis: (r cos phi, r sin phi, z) [mm]."""
    phi = np.radians(np.asarray(rotation_deg, float))
    return np.stack([points[..., 0] * np.cos(phi), points[..., 0] * np.sin(phi), points[..., 1]], axis=-1)


def _sinc(t: Vec) -> Vec:
    """sin(t) / t, 1 where t = 0."""
    return np.sinc(t / np.pi)

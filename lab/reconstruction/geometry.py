"""Geometry of the scan and its settings: segment, cap, fibre, and the measured distance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, HystmpcError, did_you_mean
from hystmpc.trials.types import Mat, Vec

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
_FULL_TURN = 360.0


class Groove(Settings):
    """Ring milled into the cap along its axis: walls are cylinders about the axis, the bottom a concentric sphere.

    Attributes:
        radius_mm: distance of its middle from the cap's axis [mm].
        width_mm: between its walls [mm].
        depth_mm: of the bottom below the smooth surface, along the sphere's radius [mm].
    """

    radius_mm: Positive
    width_mm: Positive = 2.0
    depth_mm: Positive = 1.0

    @property
    def edges_mm(self) -> tuple[float, float]:
        """Distances of the inner and the outer wall from the axis [mm]."""
        return self.radius_mm - self.width_mm / 2, self.radius_mm + self.width_mm / 2


class Pattern(Settings):
    """Surface of one sector of the cap.

    Attributes:
        grooves: from the axis outwards; none for a smooth surface.
    """

    name: Annotated[str, Field(min_length=1)]
    grooves: tuple[Groove, ...] = ()

    @model_validator(mode="after")
    def _apart(self) -> Self:
        edges = [edge for groove in self.grooves for edge in groove.edges_mm]
        if edges != sorted(set(edges)) or (edges and edges[0] <= 0):
            raise ValueError(f"pattern {self.name}: got groove edges {edges} mm, expected them apart and rising from 0")
        return self


class Cap(Settings):
    """Hollow spherical cap before the tip, open towards it, its axis along the straight catheter.

    Every sector carries one pattern; sector j covers [j sector_deg, (j + 1) sector_deg) of the rotation. Dimensions and
    groove positions are OURS (S1 Fig. 6 is lost), chosen from two conditions that know of no model: over 0 to 31 deg,
    the device's range, every ray meets the cap before the rim, and distances stay within 4 to 6 mm (to a groove's
    bottom 7 mm), as near as a ranging fibre of a few mm of depth asks. An angle error of 1 deg then displaces a point
    by 0.55 to 0.60 mm (`Segment.lever`); the tip alone by L/2 = 0.48 mm, which is S1's own "1-3 mm corresponds to
    2.09-6.26 deg".

    Attributes:
        inner_radius_mm: R of the smooth surface [mm].
        rim_deg: polar angle of the rim, seen from the sphere's centre [deg].
        standoff_mm: from the straight tip to the smooth surface on the axis [mm].
        sector_deg: of one pattern; 90 printed in S1 [deg].
        patterns: in the order of the rotation; S1: I and III with three grooves, II smooth.
    """

    inner_radius_mm: Positive = 30.0
    rim_deg: Annotated[float, Field(gt=0, le=90)] = 45.0
    standoff_mm: Positive = 6.0
    sector_deg: Positive = 90.0
    patterns: Annotated[tuple[Pattern, ...], Field(min_length=1)] = (
        Pattern(name="I", grooves=(Groove(radius_mm=4.0), Groove(radius_mm=8.0), Groove(radius_mm=12.0))),
        Pattern(name="II"),
        Pattern(name="III", grooves=(Groove(radius_mm=6.0), Groove(radius_mm=10.0), Groove(radius_mm=14.0))),
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        names = [pattern.name for pattern in self.patterns]
        if len(set(names)) != len(names):
            raise ValueError(f"cap: got patterns {', '.join(names)}, expected each name once")
        if self.sector_deg * len(names) > _FULL_TURN:
            raise ValueError(f"cap: {len(names)} sectors of {self.sector_deg:g} deg exceed a full turn")
        rim_mm = self.inner_radius_mm * math.sin(math.radians(self.rim_deg))
        for groove in (groove for pattern in self.patterns for groove in pattern.grooves):
            if groove.edges_mm[1] >= rim_mm:
                raise ValueError(f"cap: a groove ends at {groove.edges_mm[1]:g} mm, the rim lies at {rim_mm:.4g} mm")
        return self

    def pattern_at(self, rotation_deg: float) -> Pattern:
        """The pattern that lies in the bending plane after a rotation.

        Raises:
            ConfigError: if the rotation is beyond the sectors.
        """
        index = math.floor(rotation_deg / self.sector_deg) if math.isfinite(rotation_deg) else -1
        if not 0 <= index < len(self.patterns):
            end = self.sector_deg * len(self.patterns)
            raise ConfigError(f"cap: got rotation {rotation_deg:g} deg, expected 0 <= rotation < {end:g} deg")
        return self.patterns[index]

    def pattern(self, name: str) -> Pattern:
        """The pattern of that name.

        Raises:
            ConfigError: if there is none.
        """
        for pattern in self.patterns:
            if pattern.name == name:
                return pattern
        raise ConfigError(f"cap: no pattern {name!r}, {did_you_mean(name, (p.name for p in self.patterns))}")


class Oct(Settings):
    """Ranging fibre at the tip along its tangent; one distance a sample. S1 prints none of these numbers.

    Attributes:
        noise_mm: standard deviation of white noise on a distance [mm].
        axial_resolution_mm: step of the distances, 0 for none [mm].
        range_mm: greatest distance with a signal [mm].
    """

    noise_mm: NotNegative = 0.01
    axial_resolution_mm: NotNegative = 0.015
    range_mm: Positive = 10.0


class ReconstructionSettings(Settings):
    """Settings of the experiment: segment, cap, fibre, seed.

    Attributes:
        segment_length_mm: L of the bending segment; from S1's "1-3 mm corresponds to 2.09-6.26 deg" [mm].
        max_angle_deg: angles beyond it, of device or model, are refused: the ray would look backwards [deg].
    """

    segment_length_mm: Positive = 54.75
    max_angle_deg: Annotated[float, Field(gt=0, le=90)] = 90.0
    cap: Cap = Cap()
    oct: Oct = Oct()
    seed: Annotated[int, Field(ge=0)] = 0

    @property
    def centre_mm(self) -> float:
        """Height of the sphere's centre above the segment's base, on the axis [mm]; below zero where it lies behind."""
        return self.segment_length_mm + self.cap.standoff_mm - self.cap.inner_radius_mm


_SERIES_RAD = 1e-2  # below it the closed form of dz/dtheta loses digits; the next term of the series is 1e-15
_ARC_POINTS = 200


@dataclass(frozen=True)
class Segment:
    """Segment of length L with bending angle theta in a plane; r is across and z along the straight segment.

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
        """Unit vector (..., 2) of the tip's direction."""
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


def surface_distance(settings: ReconstructionSettings, pattern: Pattern, theta_deg: ArrayLike) -> Vec:
    """Distance from the tip to the cap along the tip's tangent, without noise.

    With q the tip seen from the sphere's centre and e the tangent, the ray leaves the sphere of radius rho at
    d = -q.e + sqrt((q.e)^2 - q.q + rho^2). It ends on the smooth sphere rho = R, unless it leaves that between the
    walls of a groove: then on the bottom rho = R + depth or on the wall r = edge that it runs towards, whichever comes
    first.

    Args:
        theta_deg: bending angles (T,) [deg].

    Returns:
        Distances (T,) [mm].

    Raises:
        ConfigError: if an angle is not finite or beyond the range, the tip is not inside the cap, or the ray passes
            the rim.
    """
    theta = checked_angles(settings, theta_deg, "surface")
    segment, cap = Segment(settings.segment_length_mm), settings.cap
    q = segment.tip(theta) - np.array([0.0, settings.centre_mm])
    e = segment.tangent(theta)
    inside = np.hypot(q[..., 0], q[..., 1]) < cap.inner_radius_mm
    if not np.all(inside):
        raise ConfigError(
            f"cap: at {_first(theta, ~inside):.4g} deg the tip has reached the cap "
            f"(inner radius {cap.inner_radius_mm:g} mm, standoff {cap.standoff_mm:g} mm), expected it inside"
        )
    distance = _exit(q, e, cap.inner_radius_mm)
    for groove in pattern.grooves:
        distance = _through_groove(q, e, distance, groove, cap.inner_radius_mm)
    hit = q + distance[..., None] * e
    polar = np.degrees(np.arctan2(np.abs(hit[..., 0]), hit[..., 1]))
    missed = polar > cap.rim_deg
    if np.any(missed):
        raise ConfigError(
            f"cap: the ray at {_first(theta, missed):.4g} deg misses it: polar angle {_first(polar, missed):.4g} deg, "
            f"expected at most that of the rim, {cap.rim_deg:g} deg"
        )
    return distance


def profile(settings: ReconstructionSettings, pattern: Pattern) -> Mat:
    """Cross-section of the cap as a polyline (M, 2) of r and z from the axis to the rim [mm], for figures."""
    cap = settings.cap
    radius, r = cap.inner_radius_mm, 0.0
    pieces: list[Mat] = []
    for groove in pattern.grooves:
        start, stop = groove.edges_mm
        pieces += [_arc(radius, r, start), _arc(radius + groove.depth_mm, start, stop)]
        r = stop
    pieces.append(_arc(radius, r, radius * np.sin(np.radians(cap.rim_deg))))
    return np.concatenate(pieces) + np.array([0.0, settings.centre_mm])


def checked_angles(
    settings: ReconstructionSettings, theta_deg: ArrayLike, what: str, kind: type[HystmpcError] = ConfigError
) -> Vec:
    """Check the angles and return them as an array.

    Raises:
        HystmpcError: of that `kind`, if one is not finite or beyond `max_angle_deg`; names `what`, sample and value.
    """
    theta = np.asarray(theta_deg, float)
    bad = ~(np.abs(theta) <= settings.max_angle_deg)  # NaN is bad as well
    if np.any(bad):
        raise kind(
            f"{what}: got angle {_first(theta, bad):.4g} deg at sample {int(np.argmax(bad))}, "
            f"expected within +-{settings.max_angle_deg:g} deg"
        )
    return theta


def _exit(q: Mat, e: Mat, radius: float) -> Vec:
    """Distance at which a ray from inside leaves the sphere about the origin."""
    along = np.sum(q * e, axis=-1)
    return -along + np.sqrt(along**2 - np.sum(q * q, axis=-1) + radius**2)


def _through_groove(q: Mat, e: Mat, distance: Vec, groove: Groove, radius: float) -> Vec:
    """Distances of all rays; for those that enter the groove, to its bottom or wall."""
    start, stop = groove.edges_mm
    entry = q[..., 0] + distance * e[..., 0]
    side = np.where(entry < 0, -1.0, 1.0)
    enters = (np.abs(entry) >= start) & (np.abs(entry) <= stop)
    outwards = np.where(enters, side * e[..., 0], 1.0)  # of the others nothing is asked
    edge = np.where(outwards > 0, stop, start)
    with np.errstate(divide="ignore"):
        wall = np.where(outwards == 0, np.inf, (edge - side * q[..., 0]) / outwards)
    deepest = np.minimum(_exit(q, e, radius + groove.depth_mm), wall)
    # On the very edge rounding may put the wall before the entry.
    return np.where(enters, np.maximum(deepest, distance), distance)


def _arc(radius: float, start: float, stop: float) -> Mat:
    r = np.linspace(start, stop, _ARC_POINTS)
    return np.stack([r, np.sqrt(radius**2 - r**2)], axis=-1)


def _first(values: Vec, where: NDArray[np.bool_]) -> float:
    return float(values[where].flat[0])


def measured_distance(distance_mm: Vec, oct_settings: Oct, random: np.random.Generator) -> Vec:
    """Measured distances with white noise, rounded to the axial resolution.

    Args:
        distance_mm: true distances (T,) [mm].
        random: source of the noise; it is drawn from even where the noise is 0, so that settings do not shift seeds.

    Raises:
        ConfigError: if a true distance is beyond the fibre's range.
    """
    far = distance_mm > oct_settings.range_mm
    if np.any(far):
        raise ConfigError(
            f"OCT: distance {float(np.max(distance_mm)):.4g} mm at sample {int(np.argmax(distance_mm))} is beyond "
            f"the range, expected at most {oct_settings.range_mm:g} mm"
        )
    noisy = distance_mm + oct_settings.noise_mm * random.standard_normal(distance_mm.shape)
    step = oct_settings.axial_resolution_mm
    return np.asarray(np.round(noisy / step) * step if step else noisy)

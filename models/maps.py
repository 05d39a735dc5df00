"""Maps without memory: tip angle to tip coordinates, and a laser sensor's voltage to tip angle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import FitError, ModelError
from hystmpc.trials.types import Vec

_FEWEST = 3  # points that determine a parabola


@dataclass(frozen=True)
class QuadraticMap:
    """Quadratic map y = a theta^2 + b theta + c, with its inverse on the monotone branch through theta = 0.

    Source: S2 sec. IV-B; coefficients of the authors' code.

    Attributes:
        a: [mm/deg^2].
        b: slope at theta = 0 [mm/deg], not zero.
        c: coordinate at theta = 0 [mm].

    Raises:
        ModelError: if a coefficient is not finite or b is zero.
    """

    a: float
    b: float
    c: float

    def __post_init__(self) -> None:
        if not (all(map(math.isfinite, (self.a, self.b, self.c))) and self.b != 0):
            raise ModelError(f"quadratic map: got a {self.a}, b {self.b}, c {self.c}, expected finite numbers, b not 0")

    @classmethod
    def fit(cls, theta_deg: ArrayLike, coordinate_mm: ArrayLike) -> Self:
        """Least-squares parabola through angles (T,) [deg] and one tip coordinate (T,) [mm].

        Raises:
            FitError: on different lengths, numbers that are not finite, or fewer than three different angles.
        """
        theta, y = (np.asarray(v, dtype=np.float64) for v in (theta_deg, coordinate_mm))
        if theta.ndim != 1 or theta.shape != y.shape:
            raise FitError(f"quadratic map: got shapes {theta.shape} and {y.shape}, expected the same (T,)")
        if not (np.isfinite(theta).all() and np.isfinite(y).all()):
            raise FitError("quadratic map: got values that are not finite, expected finite angles and coordinates")
        if np.unique(theta).size < _FEWEST:
            raise FitError(f"quadratic map: got {np.unique(theta).size} different angles, expected at least {_FEWEST}")
        c, b, a = np.polynomial.Polynomial.fit(theta, y, 2).convert().coef
        return cls(float(a), float(b), float(c))

    @property
    def turning_deg(self) -> float:
        """Angle of the turning point, beyond which there is no inverse [deg]; infinite for a straight line."""
        return -self.b / (2 * self.a) if self.a else math.inf

    @property
    def turning_mm(self) -> float:
        """Coordinate of the turning point: the greatest (a < 0) or least (a > 0) possible one [mm]."""
        return self.c - self.b**2 / (4 * self.a) if self.a else math.inf

    def __call__(self, theta_deg: ArrayLike) -> Vec:
        """Coordinate [mm] of the shape of `theta_deg` [deg]."""
        theta = np.asarray(theta_deg, dtype=np.float64)
        return np.asarray((self.a * theta + self.b) * theta + self.c)

    def inverse(self, coordinate_mm: ArrayLike) -> Vec:
        """Angle [deg] of the shape of `coordinate_mm` [mm]: theta = (-b + sqrt(b^2 - 4 a (c - y))) / (2 a) for b > 0.

        Raises:
            ModelError: if a coordinate lies beyond the turning point, or is not finite.
        """
        y = np.asarray(coordinate_mm, dtype=np.float64)
        discriminant = self.b**2 - 4 * self.a * (self.c - y)
        if not np.all(discriminant >= 0):  # false for not-a-number, too
            worst = y.flat[int(np.argmin(np.where(np.isnan(discriminant), -np.inf, discriminant)))]
            bound = "at most" if self.a < 0 else "at least"
            raise ModelError(
                f"quadratic map: got {worst:.6g} mm, expected {bound} {self.turning_mm:.6g} mm, where it turns "
                f"(at {self.turning_deg:.4g} deg)"
            )
        # The same root, written so that a = 0 is no special case and nothing cancels.
        return np.asarray(2 * (y - self.c) / (self.b + math.copysign(1.0, self.b) * np.sqrt(discriminant)))


@dataclass(frozen=True)
class TipMap:
    """Tip angle to tip coordinates in the bending plane by two parabolas (S2 Fig. 6(b), composite map).

    Attributes:
        x: theta [deg] to X [mm], falling for theta > 0.
        y: theta [deg] to Y [mm], rising up to its turning angle (118 deg for S2's catheter).
    """

    x: QuadraticMap
    y: QuadraticMap

    @classmethod
    def fit(cls, theta_deg: ArrayLike, x_mm: ArrayLike, y_mm: ArrayLike) -> Self:
        """Both parabolas by least squares; see `QuadraticMap.fit`.

        Raises:
            FitError: as `QuadraticMap.fit`.
        """
        return cls(QuadraticMap.fit(theta_deg, x_mm), QuadraticMap.fit(theta_deg, y_mm))

    @classmethod
    def of_plane(cls, angles_deg: ArrayLike, tip_mm: ArrayLike) -> Self:
        """Both parabolas of a part that bends alike in all planes, as a `BendShape` for `tip_from_angles`.

        Args:
            angles_deg: both bending angles (T, 2) [deg].
            tip_mm: tip x, y, z (T, 3) [mm], straight along z.

        Raises:
            FitError: as `QuadraticMap.fit`, or on other shapes.
        """
        angles, tip = (np.asarray(v, dtype=np.float64) for v in (angles_deg, tip_mm))
        if angles.ndim != 2 or angles.shape[1] != 2 or tip.shape != (len(angles), 3):
            raise FitError(f"tip map: got shapes {angles.shape} and {tip.shape}, expected (T, 2) and (T, 3)")
        bend = np.hypot(*angles.T)
        aside = np.sum(angles * tip[:, :2], axis=1) / np.maximum(bend, 1e-12)
        return cls.fit(bend, tip[:, 2], aside)

    @property
    def farthest_deg(self) -> float:
        """Bend up to which the tip goes farther aside, 180 deg at most [deg]."""
        return min(self.y.turning_deg, 180.0) if self.y.a < 0 else 180.0

    def aside(self, bend_deg: ArrayLike) -> Vec:
        """Y less that of a straight part [mm], by the bend [deg]."""
        return np.asarray(self.y(bend_deg) - self.y.c)

    def along(self, bend_deg: ArrayLike) -> Vec:
        """X [mm] by the bend [deg]."""
        return self.x(bend_deg)

    def __call__(self, theta_deg: ArrayLike) -> tuple[Vec, Vec]:
        """X and Y [mm], each of the shape of `theta_deg` [deg]."""
        return self.x(theta_deg), self.y(theta_deg)

    def angle(self, y_mm: ArrayLike) -> Vec:
        """Tip angle [deg] from Y [mm].

        Raises:
            ModelError: if Y lies beyond the turning point, or is not finite.
        """
        return self.y.inverse(y_mm)


# Coefficients of S2's published code, fitted there to all of the data and to the sinusoids only.
S2_TIP_MAP = TipMap(
    QuadraticMap(-3.62136415e-3, -4.61111115e-2, 70.4893736), QuadraticMap(-3.26109e-3, 0.77266619, 0.21515682)
)
S2_TIP_MAP_SINUSOIDS = TipMap(
    QuadraticMap(-3.38357987e-3, -6.72903484e-2, 70.5323127), QuadraticMap(-3.13098e-3, 0.75053007, 0.58506313)
)


@dataclass(frozen=True)
class LaserConversion:
    """Conversion of the voltage of S1's laser distance sensor to the tip angle.

    s = m U + n;  d = s_straight - s;  theta = 2 d L / (H^2 + d^2), where s_straight is the greatest s of the group.
    L and H stand in S1's lost Fig. 3; 54.75 mm for both agrees with its "1-3 mm corresponds to 2.09-6.26 deg".
    Source: S1 (RA-L 2021) eq. (2)-(4).

    Attributes:
        m_mm_per_v: [mm/V].
        n_mm: [mm].
        l_mm, h_mm: lengths of S1 Fig. 3 [mm].

    Raises:
        ModelError: if m, L or H is not a positive number, or n is not finite.
    """

    m_mm_per_v: float = 4.05
    n_mm: float = 29.36
    l_mm: float = 54.75
    h_mm: float = 54.75

    def __post_init__(self) -> None:
        for name in ("m_mm_per_v", "l_mm", "h_mm"):
            _require_positive(name, getattr(self, name))
        if not math.isfinite(self.n_mm):
            raise ModelError(f"n_mm: got {self.n_mm}, expected a finite number")

    @property
    def greatest_deg(self) -> float:
        """Greatest angle of eq. (4), at d = H [deg]; beyond it the displacement is not unique."""
        return math.degrees(self.l_mm / self.h_mm)

    def distance(self, voltage_v: ArrayLike) -> Vec:
        """Distance s from sensor to tip [mm] from voltage [V]. S1 eq. (2)."""
        return np.asarray(self.m_mm_per_v * np.asarray(voltage_v, dtype=np.float64) + self.n_mm)

    def voltage(self, distance_mm: ArrayLike) -> Vec:
        """Voltage [V] from distance s [mm] by the inverse of eq. (2)."""
        return np.asarray((np.asarray(distance_mm, dtype=np.float64) - self.n_mm) / self.m_mm_per_v)

    def angle(self, displacement_mm: ArrayLike) -> Vec:
        """Tip angle [deg] from the displacement d from straight [mm]. S1 eq. (4)."""
        d = np.asarray(displacement_mm, dtype=np.float64)
        return np.asarray(np.degrees(2 * d * self.l_mm / (self.h_mm**2 + d**2)))

    def displacement(self, theta_deg: ArrayLike) -> Vec:
        """Displacement d [mm] from tip angle [deg]: the root |d| <= H of eq. (4).

        Raises:
            ModelError: if an angle is beyond `greatest_deg` or not finite.
        """
        theta = np.radians(np.asarray(theta_deg, dtype=np.float64))
        inside = self.l_mm**2 - (theta * self.h_mm) ** 2
        if not np.all(inside >= 0):
            worst = np.degrees(theta.flat[int(np.argmin(np.where(np.isnan(inside), -np.inf, inside)))])
            raise ModelError(f"laser: got {worst:.6g} deg, expected at most {self.greatest_deg:.6g} deg either way")
        return np.asarray(theta * self.h_mm**2 / (self.l_mm + np.sqrt(inside)))

    def angles_of_group(self, voltage_v: ArrayLike, straight_mm: float | None = None) -> Vec:
        """Tip angles (T,) [deg] of one recorded group of voltages (T,) [V]. S1 eq. (2)-(4).

        Args:
            voltage_v: a group in time order.
            straight_mm: distance at the straight segment [mm]; the greatest of the group (eq. (3)) where left out.
        """
        s = self.distance(voltage_v)
        return self.angle((float(s.max()) if straight_mm is None else straight_mm) - s)


def _require_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ModelError(f"{name}: got {value}, expected a positive number")

"""Point clouds from scans, their errors, and rank tests between models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import mannwhitneyu

from hystmpc.trials.errors import ConfigError, HystmpcError, ModelError, did_you_mean
from hystmpc.trials.types import Mask, Mat, Vec

from .geometry import ReconstructionSettings, Segment, checked_angles, measured_distance, rotated, surface_distance
from .protocol import Scan

Unit = Literal["points", "scans"]
_SAME_DEG = 1e-6


@dataclass(frozen=True)
class RankTest:
    """Two-sided Mann-Whitney U test in one pattern. Source: S1 section III-B, p < .01 in every pattern.

    Attributes:
        unit: what is counted. `points` as S1 does; points of one scan follow each other in time, so they are not
            independent and this p is too small. `scans` takes the mean error of a scan as one observation.
        u: pairs in which the first model's error is the greater one, ties counted by half.
        p: of the null hypothesis that neither model tends to the greater errors.
    """

    pattern: str
    first: str
    second: str
    unit: Unit
    n: int
    u: float
    p: float

    @property
    def probability_smaller(self) -> float:
        """Share of pairs in which the first model's error is smaller, 0 to 1: the size of the effect."""
        return 1.0 - self.u / self.n**2


def rank_test(names: tuple[str, str], errors_mm: tuple[Vec, Vec], pattern: str, unit: Unit) -> RankTest:
    """Mann-Whitney U test on two samples of one size; p = 1 if all values are equal."""
    first, second = errors_mm
    if np.ptp(np.concatenate([first, second])) == 0:
        return RankTest(pattern, *names, unit, first.size, first.size**2 / 2, 1.0)
    found = mannwhitneyu(first, second, alternative="two-sided")
    return RankTest(pattern, *names, unit, first.size, float(found.statistic), float(found.pvalue))


@dataclass(frozen=True)
class ErrorSummary:
    """Errors of one model over a set of points.

    Attributes:
        mean_mm: S1's reconstruction error [mm].
        std_mm: population standard deviation [mm].
        max_mm: greatest error [mm].
    """

    mean_mm: float
    std_mm: float
    max_mm: float
    n: int


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Points of all scans in sequence, P in total; arrays correspond row by row.

    Attributes:
        rotation_deg: of the cap at each point (P,) [deg].
        pattern: name of the pattern at each point (P,).
        distance_mm: measured distances (P,) [mm].
        surface_mm: where the rays really met the cap (P, 3) [mm].
        truth_mm: ground truth, sensed angle with measured distance (P, 3) [mm].
        estimates_mm: model's angle with the same distance, (P, 3) for each model [mm].
        errors_mm: Euclidean distances between estimate and ground truth, (P,) for each model [mm].
        rank_tests: of the two models that were chosen for comparison; empty where none were.
    """

    settings: ReconstructionSettings
    rotation_deg: Vec
    pattern: NDArray[np.str_]
    distance_mm: Vec
    surface_mm: Mat
    truth_mm: Mat
    estimates_mm: Mapping[str, Mat]
    errors_mm: Mapping[str, Vec]
    rank_tests: tuple[RankTest, ...] = ()

    @property
    def models(self) -> tuple[str, ...]:
        """Names in the order of the scans."""
        return tuple(self.errors_mm)

    @property
    def patterns(self) -> tuple[str, ...]:
        """Names of the patterns that were scanned, in the order of the cap."""
        return tuple(p.name for p in self.settings.cap.patterns if np.any(self.pattern == p.name))

    def errors(self, model: str) -> Vec:
        """Error of every point (P,) [mm].

        Raises:
            ModelError: if there is no such model.
        """
        if model not in self.errors_mm:
            raise ModelError(f"reconstruction: no model {model!r}, {did_you_mean(model, self.errors_mm)}")
        return self.errors_mm[model]

    def in_pattern(self, name: str) -> Mask:
        """Mask of the points in a pattern (P,).

        Raises:
            ConfigError: if no point does.
        """
        if name not in self.patterns:
            raise ConfigError(f"reconstruction: no points in pattern {name!r}, {did_you_mean(name, self.patterns)}")
        return np.asarray(self.pattern == name)

    def in_scan(self, rotation_deg: float) -> Mask:
        """Mask of the points of the scan at a rotation (P,).

        Raises:
            ConfigError: if there is no such scan.
        """
        found = np.abs(self.rotation_deg - rotation_deg) < _SAME_DEG
        if not np.any(found):
            there = ", ".join(f"{phi:g}" for phi in np.unique(self.rotation_deg))
            raise ConfigError(f"reconstruction: no scan at {rotation_deg:g} deg, available: {there}")
        return found

    def summary(self, model: str, points: Mask | None = None) -> ErrorSummary:
        """Mean, spread and maximum of a model's errors over `points`, all of them where left out.

        Raises:
            ConfigError: if `points` are none.
        """
        error = self.errors(model)
        error = error if points is None else error[points]
        if error.size == 0:
            raise ConfigError("reconstruction: got no points, expected at least one")
        return ErrorSummary(float(np.mean(error)), float(np.std(error)), float(np.max(error)), error.size)

    def sensor_error_mm(self) -> Vec:
        """Distance of every ground-truth point from its true surface point (P,) [mm]: the sensors' error."""
        return np.sqrt(np.sum((self.truth_mm - self.surface_mm) ** 2, axis=1))

    def compare(self, first: str, second: str, unit: Unit = "points") -> tuple[RankTest, ...]:
        """Mann-Whitney U test of two models in every pattern."""
        errors = (self.errors(first), self.errors(second))
        tests = []
        for pattern in self.patterns:
            inside = self.in_pattern(pattern)
            a, b = (e[inside] if unit == "points" else self._scan_means(e, inside) for e in errors)
            tests.append(rank_test((first, second), (a, b), pattern, unit))
        return tuple(tests)

    def _scan_means(self, error: Vec, inside: Mask) -> Vec:
        rotations = np.unique(self.rotation_deg[inside])
        return np.array([float(np.mean(error[self.rotation_deg == rotation])) for rotation in rotations])


@dataclass(frozen=True, eq=False)
class _ScanClouds:
    distance: Vec
    surface: Mat
    truth: Mat
    estimates: dict[str, Mat]


def reconstruct(
    settings: ReconstructionSettings, scans: Sequence[Scan], compared: tuple[str, str] | None = None
) -> Reconstruction:
    """Measure the distances along the true angles and draw the cap from the sensed and from every model's angle.

    point(theta, d, phi) = R_phi (tip(theta) + d tangent(theta));  error = | point(model) - point(sensed) |, same d, phi

    Args:
        scans: in the order of the session; every one with the same models.
        compared: two models for the Mann-Whitney tests, over points and over scans.

    Raises:
        ConfigError: if there are no scans, two have one rotation, a rotation is beyond the cap, a true or sensed angle
            is beyond the range, a ray misses the cap or a distance is beyond the fibre's range.
        ModelError: if a scan has no models or others than the first, a model's angle is beyond the range, or
            `compared` names an unknown one.

    Source: S1 section III-B.
    """
    models = _checked(scans)
    random = np.random.default_rng(settings.seed)
    clouds = [_clouds(settings, scan, models, random) for scan in scans]
    sizes = [scan.true_deg.size for scan in scans]
    truth = np.concatenate([c.truth for c in clouds])
    estimates = {name: np.concatenate([c.estimates[name] for c in clouds]) for name in models}
    result = Reconstruction(
        settings=settings,
        rotation_deg=np.repeat([float(scan.rotation_deg) for scan in scans], sizes),
        pattern=np.repeat([settings.cap.pattern_at(scan.rotation_deg).name for scan in scans], sizes),
        distance_mm=np.concatenate([c.distance for c in clouds]),
        surface_mm=np.concatenate([c.surface for c in clouds]),
        truth_mm=truth,
        estimates_mm=estimates,
        errors_mm={name: np.linalg.norm(points - truth, axis=1) for name, points in estimates.items()},
    )
    if compared is None:
        return result
    return replace(result, rank_tests=result.compare(*compared) + result.compare(*compared, unit="scans"))


def _checked(scans: Sequence[Scan]) -> tuple[str, ...]:
    """Check that the models are the same in every scan, and return them."""
    if not scans:
        raise ConfigError("reconstruction: got no scans, expected at least one")
    models = tuple(scans[0].estimates_deg)
    if not models:
        raise ModelError(f"{scans[0].where}: got no model's angles, expected those of at least one")
    rotations = [scan.rotation_deg for scan in scans]
    for scan in scans:
        if set(scan.estimates_deg) != set(models):
            raise ModelError(f"{scan.where}: got models {', '.join(scan.estimates_deg)}, expected {', '.join(models)}")
        if rotations.count(scan.rotation_deg) > 1:
            raise ConfigError(f"{scan.where}: occurs twice, expected each rotation once")
    return models


def _clouds(
    settings: ReconstructionSettings, scan: Scan, models: tuple[str, ...], random: np.random.Generator
) -> _ScanClouds:
    segment = Segment(settings.segment_length_mm)
    true = checked_angles(settings, scan.true_deg, f"{scan.where}, true angle")
    exact = surface_distance(settings, settings.cap.pattern_at(scan.rotation_deg), true)
    distance = measured_distance(exact, settings.oct, random)

    def drawn(angles: Vec, what: str, kind: type[HystmpcError] = ConfigError) -> Mat:
        theta = checked_angles(settings, angles, f"{scan.where}, {what}", kind)
        return rotated(segment.point(theta, distance), scan.rotation_deg)

    return _ScanClouds(
        distance=distance,
        surface=rotated(segment.point(true, exact), scan.rotation_deg),
        truth=drawn(scan.sensed_deg, "sensed angle"),
        estimates={name: drawn(scan.estimates_deg[name], f"model {name!r}", ModelError) for name in models},
    )

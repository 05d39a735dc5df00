"""From scans to clouds of points and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hystmpc.trials.errors import ConfigError, HystmpcError, ModelError
from hystmpc.trials.types import Mat, Vec

from .oct_distance import measured_distance
from .ray import checked_angles, surface_distance
from .result import Reconstruction
from .scan import Scan
from .segment import Segment, rotated
from .settings import ReconstructionSettings


@dataclass(frozen=True, eq=False)
class _ScanClouds:
    """Points of one scan."""

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
        settings: what is scanned with what.
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
    """The models, which are the same in every scan."""
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

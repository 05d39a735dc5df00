"""What a reconstruction gives: clouds of points, errors, tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import ConfigError, ModelError, did_you_mean
from hystmpc.trials.types import Mask, Mat, Vec

from .rank_test import RankTest, Unit, rank_test
from .settings import ReconstructionSettings

_SAME_DEG = 1e-6


@dataclass(frozen=True)
class ErrorSummary:
    """Errors of one model over a set of points.

    Attributes:
        mean_mm: S1's reconstruction error [mm].
        std_mm: population standard deviation [mm].
        max_mm: greatest error [mm].
        n: number of points.
    """

    mean_mm: float
    std_mm: float
    max_mm: float
    n: int


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Points of all scans, one after another, P in all; paired row by row.

    Attributes:
        settings: what was scanned with what.
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
        """Which points lie in a pattern (P,).

        Raises:
            ConfigError: if no point does.
        """
        if name not in self.patterns:
            raise ConfigError(f"reconstruction: no points in pattern {name!r}, {did_you_mean(name, self.patterns)}")
        return np.asarray(self.pattern == name)

    def in_scan(self, rotation_deg: float) -> Mask:
        """Which points belong to the scan at a rotation (P,).

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
            ModelError: if there is no such model.
            ConfigError: if `points` are none.
        """
        error = self.errors(model)
        error = error if points is None else error[points]
        if error.size == 0:
            raise ConfigError("reconstruction: got no points, expected at least one")
        return ErrorSummary(float(np.mean(error)), float(np.std(error)), float(np.max(error)), error.size)

    def sensor_error_mm(self) -> Vec:
        """Distance of every ground-truth point from where its ray met the cap (P,) [mm]: the sensors' own error."""
        return np.sqrt(np.sum((self.truth_mm - self.surface_mm) ** 2, axis=1))

    def compare(self, first: str, second: str, unit: Unit = "points") -> tuple[RankTest, ...]:
        """Mann-Whitney U test of two models in every pattern.

        Raises:
            ModelError: if one of them is unknown.
        """
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

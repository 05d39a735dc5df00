"""One scan: a back-and-forth of the tip before one rotation of the cap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.errors import ConfigError, ModelError
from hystmpc.trials.types import Vec


@dataclass(frozen=True, eq=False)
class Scan:
    """Angles of one scan, sample by sample.

    Attributes:
        rotation_deg: of the cap [deg].
        true_deg: angles of the tip, along which distances are measured (T,) [deg].
        sensed_deg: angles by the sensor, of which the ground truth is made (T,) [deg].
        estimates_deg: angles by each model, (T,) each [deg].

    Raises:
        ConfigError: if the scan is empty or an angle of device or sensor is not finite, or lengths differ.
        ModelError: if that holds for a model's angles.
    """

    rotation_deg: float
    true_deg: Vec
    sensed_deg: Vec
    estimates_deg: Mapping[str, Vec]

    def __post_init__(self) -> None:
        if self.true_deg.ndim != 1 or self.true_deg.size == 0:
            raise ConfigError(f"{self.where}: got true angles of shape {self.true_deg.shape}, expected (T,) with T > 0")
        if problem := self._problem(self.true_deg):
            raise ConfigError(f"{self.where}: true angles: {problem}")
        if problem := self._problem(self.sensed_deg):
            raise ConfigError(f"{self.where}: sensed angles: {problem}")
        for name, angles in self.estimates_deg.items():
            if problem := self._problem(angles):
                raise ModelError(f"{self.where}: model {name!r}: {problem}")

    @property
    def where(self) -> str:
        """The scan as messages name it."""
        return f"scan at {self.rotation_deg:g} deg"

    def _problem(self, angles: Vec) -> str:
        """What is wrong with an array of angles; empty where nothing is."""
        if angles.shape != self.true_deg.shape:
            return f"got shape {angles.shape}, expected {self.true_deg.shape}"
        bad = ~np.isfinite(angles)
        return f"got {angles[bad][0]} at sample {int(np.argmax(bad))}, expected finite angles" if np.any(bad) else ""

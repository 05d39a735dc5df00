"""What the ranging fibre makes of a distance."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .settings import Oct


def measured_distance(distance_mm: Vec, oct_settings: Oct, random: np.random.Generator) -> Vec:
    """Measured distances: white noise first, then the nearest step of the axial resolution.

    Args:
        distance_mm: true distances (T,) [mm].
        oct_settings: the fibre.
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

"""What the papers' sensors make of a true motion: distortion, noise, quantisation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hystmpc.models.maps import S2_TIP_MAP, LaserConversion, TipMap
from hystmpc.trials.types import Vec

from .quantities import check_quantities, quantity

_TURN_DEG = 40.0  # tip angle over which the field's distortion turns once


@dataclass(frozen=True)
class EmTracker:
    """The electromagnetic tracker of S2 on the tip: angle, and X, Y by the quadratic map of S2.

    S2 states an accuracy of +-0.35 deg and +-1.4 mm. Such an error is mostly distortion of the field: it depends on
    the pose and comes back in every trial. Here it is a sine of the tip angle, of half the stated size for the angle,
    and of 0.3 mm for the position, whose rest would be a shift of the frame. The noise is white; its size is of the
    order that recorded logs of such a device show once they are resampled to 25 Hz.

    Raises:
        ConfigError: if a number is out of its bounds.
    """

    distortion_deg: float = quantity(0.175, "deg", 0.0, 10.0, "amplitude of the distortion of the angle")
    noise_deg: float = quantity(0.05, "deg", 0.0, 10.0, "standard deviation of the angle's noise")
    quantisation_deg: float = quantity(180.0 / 2**15, "deg", 0.0, 10.0, "step of the angle")
    distortion_mm: float = quantity(0.3, "mm", 0.0, 10.0, "amplitude of the distortion of X and Y")
    noise_mm: float = quantity(0.05, "mm", 0.0, 10.0, "standard deviation of the noise of X and Y")
    tip: TipMap = field(default_factory=lambda: S2_TIP_MAP)

    def __post_init__(self) -> None:
        check_quantities(self)

    def __call__(self, angle_deg: Vec, random: np.random.Generator) -> tuple[Vec, Vec, Vec]:
        """Measured angle [deg], X and Y [mm] from true angles, all (T,)."""
        noise = random.standard_normal((3, angle_deg.size))
        phase = 2 * np.pi * angle_deg / _TURN_DEG
        angle = angle_deg + self.distortion_deg * np.sin(phase) + self.noise_deg * noise[0]
        x, y = self.tip(angle_deg)
        x = x + self.distortion_mm * np.sin(phase + 1.0) + self.noise_mm * noise[1]
        y = y + self.distortion_mm * np.sin(phase + 2.0) + self.noise_mm * noise[2]
        return quantised(angle, self.quantisation_deg), x, y


@dataclass(frozen=True)
class LaserSensor:
    """The laser distance sensor of S1 beside the tip, read by a converter: voltage from true angle (S1 eq. (2)-(4)).

    S1 prints neither noise nor resolution: 0.02 mm (0.04 deg near straight), and the 9.8 mV (0.04 mm) of a 10 V range
    on the 10 bits of its Arduino.

    Raises:
        ConfigError: if a number is out of its bounds.
    """

    straight_mm: float = quantity(60.0, "mm", 0.0, 1000.0, "distance to the tip of the straight catheter")
    noise_mm: float = quantity(0.02, "mm", 0.0, 10.0, "standard deviation of the noise of the distance")
    quantisation_v: float = quantity(10.0 / 2**10, "V", 0.0, 10.0, "step of the converter")
    conversion: LaserConversion = field(default_factory=LaserConversion)

    def __post_init__(self) -> None:
        check_quantities(self)

    def __call__(self, angle_deg: Vec, random: np.random.Generator) -> Vec:
        """Voltage [V] at true angles (T,) [deg].

        Raises:
            ModelError: if an angle is beyond what the conversion can tell.
        """
        distance = self.straight_mm - self.conversion.displacement(angle_deg)
        noisy = distance + self.noise_mm * random.standard_normal(angle_deg.size)
        return quantised(self.conversion.voltage(noisy), self.quantisation_v)


def quantised(values: Vec, step: float) -> Vec:
    """Values rounded to multiples of `step`; as they are for step 0."""
    return np.round(values / step) * step if step > 0 else values

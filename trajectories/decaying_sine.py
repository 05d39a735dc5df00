"""The decaying sinusoid, chirped or not, of which both papers' identification commands are cases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.types import Vec

from .checks import require_finite, require_positive
from .trajectory import inside


@dataclass(frozen=True)
class DecayingSine:
    """u(t) = A e^(-tau t) ( sin(2 pi (f + c t) t - pi/2) + a ) + B, for 0 <= t <= T.

    The instantaneous frequency is f + 2 c t, not f + c t: a falling chirp (c < 0) stands still at t = -f / (2 c).
    Sources: Wu et al., RA-L 2021 (S1) eq. (5), (6), (10), (11); RA-L 2024, PMC11633443 (S2) eq. (9), (10).

    Attributes:
        amplitude: A [mm or bar].
        frequency_hz: f [Hz].
        decay_per_s: tau [1/s]; below zero the sinusoid grows.
        duration_s: T [s].
        lift: a, the part of the offset that decays with the sinusoid, in units of A.
        baseline: B, the part of the offset that stays [mm or bar].
        chirp_hz_per_s: c [Hz/s].

    Raises:
        TrajectoryError: if a number is not finite, or amplitude, frequency or duration is not positive.
    """

    amplitude: float
    frequency_hz: float
    decay_per_s: float
    duration_s: float
    lift: float = 1.0
    baseline: float = 0.0
    chirp_hz_per_s: float = 0.0

    def __post_init__(self) -> None:
        require_positive(amplitude=self.amplitude, frequency_hz=self.frequency_hz, duration_s=self.duration_s)
        require_finite(
            decay_per_s=self.decay_per_s,
            lift=self.lift,
            baseline=self.baseline,
            chirp_hz_per_s=self.chirp_hz_per_s,
        )

    def __call__(self, t: ArrayLike) -> Vec:
        """Command [mm or bar] at `t` [s]."""
        time = inside(t, self.duration_s)
        wave = np.sin(2 * np.pi * (self.frequency_hz + self.chirp_hz_per_s * time) * time - np.pi / 2)
        envelope = self.amplitude * np.exp(-self.decay_per_s * time)
        return np.asarray(envelope * (wave + self.lift) + self.baseline)

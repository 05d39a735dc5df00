"""Targets that move with breathing and heartbeat: periodic shifts that are added to a motion in the plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .plane import PlaneMotion, Point

_DWELL = 2  # n of the breathing: the greater, the longer the rest at its end
_SYSTOLE = 0.4  # part of a beat in which the heart contracts and relaxes
_EASE_S = 1.0  # in which the tissue's motion begins, and ends


@final
@dataclass(frozen=True)
class TissueMotion:
    """Shift of a target by breathing and heartbeat, zero at time 0.

        shift(t) = b sin^4(pi t / T) + h p(t f mod 1),    p(s) = sin^2(pi s / .4) for s < .4, else 0

    The breathing dwells at the end of each breath (Lujan et al., Medical Physics 26 (1999), eq. 1 with n = 2). The
    heartbeat is a contraction in the first four tenths of each beat, then a rest: a model of ours, without a source.

    Attributes:
        breathing: b, greatest shift of both axes by a breath [deg, or mm].
        breath_s: T [s].
        heartbeat: h, greatest shift of both axes by a beat.
        beats_per_min: 60 f.

    Raises:
        TrajectoryError: if a number is not finite, or a period or rate is not positive.
    """

    breathing: Point = (0.0, 0.0)
    breath_s: float = 4.0
    heartbeat: Point = (0.0, 0.0)
    beats_per_min: float = 70.0

    def __post_init__(self) -> None:
        numbers = np.array([*self.breathing, *self.heartbeat, self.breath_s, self.beats_per_min])
        if not (np.isfinite(numbers).all() and self.breath_s > 0 and self.beats_per_min > 0):
            raise TrajectoryError(
                f"tissue: got {numbers.tolist()}, expected finite shifts, positive breath_s and beats_per_min"
            )

    def __call__(self, t: ArrayLike) -> Vec:
        """Shift (..., 2) at `t` [s]."""
        times = np.asarray(t, dtype=np.float64)[..., None]
        breath = np.sin(np.pi * times / self.breath_s) ** (2 * _DWELL)
        phase = np.mod(times * self.beats_per_min / 60.0, 1.0)
        beat = np.where(phase < _SYSTOLE, np.sin(np.pi * phase / _SYSTOLE) ** 2, 0.0)
        return np.asarray(breath * np.array(self.breathing) + beat * np.array(self.heartbeat))


def on_tissue(motion: PlaneMotion, tissue: TissueMotion) -> PlaneMotion:
    """Motion on a target that moves with the tissue; the shift is eased in and out, so that both ends are at rest."""
    ease_s = min(_EASE_S, 0.25 * motion.duration_s)

    def angles(t: Vec) -> Vec:
        s = np.clip(np.minimum(t, motion.duration_s - t) / ease_s, 0.0, 1.0)
        return motion(t) + (s * s * (3 - 2 * s))[..., None] * tissue(t)

    return PlaneMotion(angles, motion.duration_s)

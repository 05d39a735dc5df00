"""What an effect may know of the trial that it acts in."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.types import Vec

FINE_S = 0.002
RATE_HZ = 25.0
PARTS = round(1 / (RATE_HZ * FINE_S))


@dataclass(frozen=True)
class Scene:
    """One trial of one device.

    Attributes:
        seed: of the case; everything random of a trial comes from `random`.
        trial: number of the trial in recording order, from 0.
        clock_s: time from the start of the first trial to that of this one [s].
        travel: greatest command [mm].
        rest_deg, span_deg: angle at zero command, and the change to the greatest [deg].
    """

    seed: int
    trial: int
    clock_s: float
    travel: float
    rest_deg: float
    span_deg: float

    def random(self, name: str, every_trial: bool = True) -> np.random.Generator:
        """Draws of one effect in this trial, or of the whole device: the same for every size of the effect."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode()), self.trial + 1 if every_trial else 0])

    def unit(self, angle: Vec) -> Vec:
        """Bend over the span: 0 at rest, about 1 at the greatest command."""
        return (angle - self.rest_deg) / self.span_deg


def fine_times(samples: int) -> Vec:
    """Times of the fine steps that cover `samples` samples at `RATE_HZ` [s]."""
    return np.asarray(np.arange((samples - 1) * PARTS + 1) * FINE_S, dtype=np.float64)


def rise(signal: Vec) -> Vec:
    """Speed by differences of the fine signal [1/s], zero at the start."""
    return np.asarray(np.diff(signal, prepend=signal[0]) / FINE_S, dtype=np.float64)

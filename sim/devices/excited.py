"""Commands on a time grid, and seeds that belong to a trial by its name."""

from __future__ import annotations

import zlib

import numpy as np

from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.types import Vec

_ROUNDING = 1e-9  # of a sample, so that a duration of whole samples is not cut short


def sampled(excitation: Trajectory, rate_hz: float) -> tuple[Vec, Vec]:
    """Times [s] and commands, both (T,), on a grid that begins at 0 and ends before the duration."""
    count = max(int(np.ceil(excitation.duration_s * rate_hz - _ROUNDING)), 2)
    t = np.arange(count) / rate_hz
    return t, np.asarray(excitation(t), dtype=np.float64)


def generator(seed: int, name: str, purpose: str) -> np.random.Generator:
    """Random numbers of one trial for one purpose; they do not depend on which other trials are made, or when."""
    return np.random.default_rng([seed, zlib.crc32(f"{purpose}:{name}".encode())])

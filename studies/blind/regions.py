"""Where in the motion an error lies: the regions in which a localisation is scored."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.segments import Motion, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

REGIONS = ("loading", "unloading", "after_reversal", "hold", "first_flexure")
DENSE = 1.25
"""Density from which on a region counts as one in which the gap lies."""
_WIDTH = 0.1  # travel after a reversal, as a share of the range


def region_of(trial: Trial) -> NDArray[np.intp]:
    """Index into `REGIONS` of every sample (T,).

    A hold is a hold; else before the first reversal it is the first flexure; else within a tenth of the travel after
    a reversal it is that; else loading or unloading.
    """
    segments = segment(trial)
    region = np.where(segments.labels >= Motion.LOADING, 0, 1).astype(np.intp)
    span = max(float(np.ptp(trial.command)), 1e-9)
    for turn in segments.reversals:
        away = np.abs(trial.command[turn:] - trial.command[turn]) > _WIDTH * span
        stop = turn + (int(np.argmax(away)) if away.any() else away.size)
        region[turn + 1 : stop] = 2
    if segments.reversals.size:
        region[: segments.reversals[0] + 1] = 4
    region[segments.labels == Motion.HOLD] = 3
    return region


def densities(trials: Sequence[Trial], errors: Sequence[Vec]) -> dict[str, float]:
    """Share of the squared error over share of the samples, by region; regions without samples are left out."""
    region = np.concatenate([region_of(trial) for trial in trials])
    square = np.concatenate(list(errors)) ** 2
    total = max(float(square.mean()), 1e-12)
    return {name: float(square[region == k].mean()) / total for k, name in enumerate(REGIONS) if np.any(region == k)}

"""Trials on one uniform grid, as identifications and comparisons take them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .command_noise import quiet
from .errors import LogError
from .trial import Trial, parts_at_gaps, require_uniform, resample


def at_rate(trials: Iterable[Trial], rate_hz: float) -> list[Trial]:
    """Trials cut at their gaps, on a uniform grid, without the noise of a measured command (`quiet`).

    One without such noise that lies on the grid is left as it is.

    Raises:
        ConfigError, LogError: see `parts_at_gaps` and `resample`.
    """
    parts = quiet([part for trial in trials for part in parts_at_gaps(trial)])
    return [part if _lies_at(part, rate_hz) else resample(part, rate_hz) for part in parts]


def _lies_at(trial: Trial, rate_hz: float) -> bool:
    try:
        return bool(np.isclose(require_uniform(trial) * rate_hz, 1.0, rtol=1e-9))
    except LogError:
        return False

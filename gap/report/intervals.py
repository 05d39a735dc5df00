"""90 % intervals of an RMSE over whole blocks of time, since neighbouring residuals are alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.models.identify.uncertainty import Interval
from hystmpc.trials.types import Vec

from .evidence import Stage, TrialEvidence

_BLOCK_S, _LEAST_BLOCKS = 2.0, 4
_DRAWS = 400


def rmse_interval(trials: Sequence[TrialEvidence], stage: Stage) -> Interval | None:
    """90 % block-bootstrap interval of the RMSE over some trials [deg]; None for less than four blocks of 2 s.

    Drawn with one seed, so that a report is the same each time.
    """
    sums, counts = _blocks(trials, stage)
    if sums.size < _LEAST_BLOCKS:
        return None
    draws = np.random.default_rng(0).integers(0, sums.size, (_DRAWS, sums.size))
    values = np.sqrt(sums[draws].sum(axis=1) / counts[draws].sum(axis=1))
    low, high = np.quantile(values, (0.05, 0.95))
    return float(low), float(high)


def _blocks(trials: Sequence[TrialEvidence], stage: Stage) -> tuple[Vec, Vec]:
    """Sum of squares [deg^2] and number of samples of every block."""
    sums, counts = list[float](), list[float]()
    for trial in trials:
        squares = trial.residual(stage) ** 2
        length = max(1, round(_BLOCK_S / trial.trial.dt))
        for block in np.array_split(squares, max(1, squares.size // length)):
            sums.append(float(block.sum()))
            counts.append(float(block.size))
    return np.array(sums), np.array(counts)

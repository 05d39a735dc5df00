"""Squared errors in blocks of a few seconds: what is compared, and drawn anew, when two explanations are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.types import Vec

from .recording import Run

_BLOCK_S = 3.0


@dataclass(frozen=True, eq=False)
class Blocks:
    """Squared errors in blocks; blocks without a sample are left out.

    Attributes:
        energy: sum of squared errors of each block (B,) [deg^2].
        samples: of each block (B,).
        run: number of the run that each belongs to (B,).
    """

    energy: Vec
    samples: Vec
    run: NDArray[np.intp]

    @property
    def mse(self) -> float:
        """Mean square error [deg^2]."""
        return float(self.energy.sum() / self.samples.sum())


def blocks_of(errors: Sequence[Vec], runs: Sequence[Run]) -> Blocks:
    """Errors (C,) of the counted samples of each run, in blocks of three seconds."""
    energy, samples, owner = [], [], []
    for k, (error, run) in enumerate(zip(errors, runs, strict=True)):
        blocks = run.blocks(_BLOCK_S)
        blocks = blocks - blocks.min()
        energy.append(np.bincount(blocks, error**2).astype(np.float64))
        samples.append(np.bincount(blocks).astype(np.float64))
        owner.append(np.full(energy[-1].size, k))
    filled = np.concatenate(samples) > 0
    return Blocks(np.concatenate(energy)[filled], np.concatenate(samples)[filled], np.concatenate(owner)[filled])

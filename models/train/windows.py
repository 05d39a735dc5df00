"""Short windows of trials, as both papers train on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.trials.errors import FitError
from hystmpc.trials.types import Vec

from ..train.runs import Float32, Rng


def draw_windows(runs: Sequence[tuple[Vec, ...]], count: int, length: int, rng: Rng) -> tuple[Float32, ...]:
    """Random windows (count, length) of random runs, one array for each signal (T,) that the runs have.

    Every run is as likely as every other, every start within a run as well, as in the code of S2.

    Raises:
        FitError: if a run is shorter than a window.
    """
    shortest = min(run[0].size for run in runs)
    if shortest < length:
        raise FitError(f"shortest trial has {shortest} samples, expected at least the {length} of a window")
    chosen = [runs[k] for k in rng.integers(len(runs), size=count)]
    starts = [int(rng.integers(run[0].size - length + 1)) for run in chosen]
    return tuple(
        np.stack([run[j][a : a + length] for run, a in zip(chosen, starts, strict=True)]).astype(np.float32)
        for j in range(len(runs[0]))
    )

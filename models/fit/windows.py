"""Short windows of trials, as both papers train on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.trials.errors import FitError

from .streams import Float32, Rng, Run


def draw_windows(runs: Sequence[Run], count: int, length: int, rng: Rng) -> tuple[Float32, Float32, Float32]:
    """Command, angle and weight (count, length) each: random windows of random runs.

    Every run is as likely as every other, every start within a run as well, as in the code of S2.

    Raises:
        FitError: if a run is shorter than a window.
    """
    shortest = min(run.command.size for run in runs)
    if shortest < length:
        raise FitError(f"shortest trial has {shortest} samples, expected at least the {length} of a window")
    chosen = [runs[k] for k in rng.integers(len(runs), size=count)]
    starts = [int(rng.integers(run.command.size - length + 1)) for run in chosen]
    parts = [
        np.stack([getattr(run, name)[a : a + length] for run, a in zip(chosen, starts, strict=True)])
        for name in ("command", "angle", "weight")
    ]
    command, angle, weight = (part.astype(np.float32) for part in parts)
    return command, angle, weight

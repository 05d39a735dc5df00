"""Which trials are held out to stop training: whole trials, never parts of one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial

FEW_TRIALS = 8


def hold_out(trials: Sequence[Trial], count: int, seed: int) -> tuple[list[Trial], list[Trial]]:
    """Training and held-out trials, both in the order given.

    From fewer than eight trials the most ordinary ones are held out, so that the motions at the edges (slowest,
    fastest, lowest, highest) remain in training: a network that has not seen them would be stopped for the wrong
    reason. From eight on the draw is random by `seed`.

    Raises:
        FitError: if no trial would be left for training.
    """
    if count >= len(trials):
        raise FitError(f"got {len(trials)} trials, expected at least {count + 1}: {count} held out and one to train on")
    if len(trials) < FEW_TRIALS:
        chosen = set(np.argsort(_distance_from_median(trials), kind="stable")[:count].tolist())
    else:
        chosen = set(np.random.default_rng(seed).permutation(len(trials))[:count].tolist())
    return [t for k, t in enumerate(trials) if k not in chosen], [t for k, t in enumerate(trials) if k in chosen]


def _distance_from_median(trials: Sequence[Trial]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Distance of each trial from the median one in mean command, spread of the command and logarithm of its speed."""
    features = np.array(
        [[t.command.mean(), t.command.std(), np.log(np.mean(np.abs(np.diff(t.command))) / t.dt)] for t in trials]
    )
    spread = features.std(axis=0)
    return np.linalg.norm((features - np.median(features, axis=0)) / np.where(spread > 0, spread, 1.0), axis=1)

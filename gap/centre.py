"""Shifts of trials count from their mean: what all of them have in common belongs to the simulator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .problem import Problem
from .recording import Run

Vec = NDArray[np.float64]
_COMMON = 2  # offset and gain, the first of the terms
_ROUNDS = 2  # the angle is not quite linear in its numbers
_TOLERANCE = 1e-6


def centred(problem: Problem, q: Vec, runs: Sequence[Run]) -> Vec:
    """Unknowns with the mean of the trials' own terms moved into the baseline.

    With an offset and a gain of each trial nothing determines the common ones, and a fit leaves them anywhere.
    The baseline's step dz is the least one that does what the mean w of the trials' offset and gain does,

        sum_trials |d theta / d z dz + C w|^2 = min

    Args:
        problem: with a shift of each trial; any other comes back as it is.
        q: unknowns (Q,).
        runs: that they were fitted to.
    """
    if not problem.terms.shift:
        return q
    q, own = q.copy(), problem.own
    for _ in range(_ROUNDS):
        parts = [(run.counts, *problem.linearised(q, run), run) for run in runs]
        weights = np.mean([problem.terms.weights(run, theta, by_q)[:_COMMON] for _, theta, by_q, run in parts], axis=0)
        common = [problem.terms.columns(run, theta[k], by_q[k])[:, :_COMMON] @ weights for k, theta, by_q, run in parts]
        slopes = np.concatenate([by_q[k, :own] for k, _, by_q, _ in parts])
        step = np.linalg.lstsq(slopes, -np.concatenate(common), rcond=_TOLERANCE)[0]
        q[:own] = np.clip(q[:own] + step, problem.lower[:own], problem.upper[:own])
    return q

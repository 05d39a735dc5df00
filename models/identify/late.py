"""By how much a device is late: dead time and lag of a straight line, before anything else is known of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from hystmpc.trials.types import Vec

from .runs import Run

SHARE = 0.25
"""Of the shortest trial: a longer delay is not looked for, too little of the trial would show it."""

_TAUS_S = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
_NEARER = (0.7, 0.84, 1.0, 1.19, 1.4)
_FINEST, _FINER = 16, 1.15  # samples up to which every delay is tried, and the factor between longer ones


def dead_time(runs: Sequence[Run]) -> float:
    """Delay [s] of the best line behind a dead time and a lag of first order, on a coarse grid of both.

        theta = a + b G u,  G = exp(-s delay) / (tau s + 1)

    of all trials, each with an offset of its own. It says where a delay is to be looked for, not how long it is:
    hysteresis is late, too.

    Source: first-order plus dead-time models, e.g. Astrom and Hagglund, Advanced PID Control (2006), section 2.6.
    """
    dt_s = runs[0].dt_s
    most = max(1, math.floor(SHARE * min(run.command.size for run in runs)))
    shifts = {round(v) for v in np.geomspace(_FINEST, most, 1 + math.ceil(max(0.0, math.log(most / _FINEST, _FINER))))}
    delays = sorted({*range(min(_FINEST, most) + 1), *shifts}) if most > _FINEST else list(range(most + 1))
    angles = [run.angle - run.angle.mean() for run in runs]
    delay_samples, tau = _best(runs, angles, delays, _TAUS_S)
    near = range(math.floor(delay_samples / _FINER), min(most, math.ceil(delay_samples * _FINER)) + 1)
    return _best(runs, angles, near, [tau * factor for factor in _NEARER])[0] * dt_s


def _best(
    runs: Sequence[Run], angles: Sequence[Vec], delays: Sequence[int], taus: Sequence[float]
) -> tuple[int, float]:
    """Delay in samples and time constant [s] of the least squared error."""
    best, chosen = math.inf, (0, 0.0)
    for tau in taus:
        kept = math.exp(-runs[0].dt_s / tau) if tau else 0.0
        late = [np.asarray(lfilter([1 - kept], [1, -kept], run.command - run.command[0])) for run in runs]
        for delay in delays:
            left = _left(late, angles, delay)
            if left < best:
                best, chosen = left, (delay, tau)
    return chosen


def _left(late: Sequence[Vec], angles: Sequence[Vec], delay: int) -> float:
    """Squared error of the best line through delayed commands."""
    squares = products = power = 0.0
    for command, angle in zip(late, angles, strict=True):
        moved = np.concatenate([np.zeros(delay), command[: command.size - delay]])
        moved -= moved.mean()
        squares += float(moved @ moved)
        products += float(moved @ angle)
        power += float(angle @ angle)
    return power - products**2 / squares if squares > 0 else power

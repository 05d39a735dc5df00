"""Resolution of a sensor: the step of the grid that its readings lie on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.trials.types import Vec

_ON_GRID, _GRID_TOLERANCE = 0.95, 0.1  # share of readings; of the step (a fifth of them is that near by chance)
_LEAST_LEVELS, _READINGS, _MOST_VALUES = 3, 25, 20_000  # readings on a level, where levels are few
_MANY_LEVELS = 9  # that no chance puts on a grid
_APART = 0.5  # of the gap between levels: readings closer together than that are of one level


def resolution(signals: Sequence[Vec]) -> float:
    """Step of the grid that the readings of a sensor lie on, in their unit; 0 of a continuous sensor.

    The grid may have any offset. It is looked for in all readings and in those that repeat the one before, which
    linear interpolation to another rate leaves on it, and then in clusters of them, where a little noise was added
    after rounding. A log of few digits is on a grid, too: that of its last digit.

    Args:
        signals: readings of one sensor, (T,) each.
    """
    values = np.concatenate(signals)
    repeated = np.concatenate([signal[1:][np.diff(signal) == 0] for signal in signals])
    step = max(grid_step(values), _of_many_levels(repeated, np.unique(repeated)))
    return step or _of_many_levels(values, _clusters(values))


def grid_step(values: Vec) -> float:
    """Largest step of a grid with any offset that holds 95 % of the values; 0 without one."""
    return _step(values, np.unique(values))


def _of_many_levels(values: Vec, levels: Vec) -> float:
    """As `grid_step`, of so many levels that chance does not put them on a grid."""
    return _step(values, levels) if levels.size >= _MANY_LEVELS else 0.0


def _clusters(values: Vec) -> Vec:
    """Middles of groups of values between gaps like the widest ones; each value where none stand out."""
    ordered = np.sort(values)
    gaps = np.diff(ordered)
    if gaps.size < _MANY_LEVELS:
        return ordered
    ends = np.flatnonzero(gaps > _APART * np.partition(gaps, -_MANY_LEVELS + 1)[-_MANY_LEVELS + 1])
    return np.array([part.mean() for part in np.split(ordered, ends + 1)])


def _step(values: Vec, levels: Vec) -> float:
    if levels.size < 2:
        return 0.0
    levels = levels[:: max(1, levels.size // _MOST_VALUES)] if levels.size > _MOST_VALUES else levels
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * max(float(np.abs(levels).max()), 1.0)]
    if gaps.size + 1 < (_LEAST_LEVELS if values.size >= _READINGS * (gaps.size + 1) else _MANY_LEVELS):
        return 0.0
    least = float(np.percentile(gaps, 1))
    coarse = gaps[gaps > 0.5 * float(np.median(gaps))]
    guesses = {float(np.median(gaps)), float(np.percentile(coarse, 5)), float(np.percentile(gaps, 10)), least}
    fits = [_fitted(levels, guess, values) for guess in guesses]
    return max((step for step, share in fits if share >= _ON_GRID), default=0.0)


def _fitted(levels: Vec, guess: float, values: Vec) -> tuple[float, float]:
    """Step near the guess by regression of levels on their whole numbers, and the share of values on that grid."""
    numbers = np.concatenate([[0.0], np.cumsum(np.rint(np.diff(levels) / guess))])
    if numbers[-1] + 1 < min(_MANY_LEVELS, levels.size):
        return 0.0, 0.0
    step = float(np.polyfit(numbers, levels, 1)[0])
    if step <= 0:
        return 0.0, 0.0
    turn = np.exp(2j * np.pi * values / step)
    off = np.angle(turn * np.conj(np.mean(turn))) / (2 * np.pi)
    return step, float(np.mean(np.abs(off) <= _GRID_TOLERANCE))

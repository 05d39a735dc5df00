"""Localisation of the residual: the parts of the motion in which its energy lies. It proposes and does not decide."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.errors import GapError
from hystmpc.trials.segments import Motion
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Vec

from ..diagnosis import Place
from ..logs.motion_type import command_segments
from ..logs.noise_floor import require_residuals
from .memory import memory_gains
from .spectrum import Spectrum, spectrum_of

PLACES = ("loading", "unloading", "after_reversal", "hold", "first_flexure")
"""Parts of a motion, exclusive; precedence: hold, first_flexure, after_reversal, direction."""

_AFTER = 0.1  # way after a reversal that counts as after it, as a share of the command's range in the trial
_RESAMPLES = 500
_BLOCK_S, _LEAST_BLOCKS = 2.0, 10


@dataclass(frozen=True)
class Localisation:
    """Parts of the residual.

    Attributes:
        places: per part of the motion; shares add up to one.
        spectrum: by frequency.
        memory: share that each kind of memory explains held out, by name; below zero if none.
    """

    places: Mapping[str, Place]
    spectrum: Spectrum
    memory: Mapping[str, float]


def localise(
    trials: Sequence[Trial], residuals: Sequence[Vec], loop_width: float, seed: int = 0, ordered: bool = True
) -> Localisation:
    """Share and density of the residual's energy e^2 over parts of the motion, frequencies and memories.

    90 % intervals come from 500 resamples of blocks of time within trials: of 2 s or, if longer, four times the lag at
    which the residual's correlation falls to 1/e; ten blocks or more.

    Args:
        trials: uniform, at one rate.
        residuals: measured less simulated angle, (T,) each [deg].
        loop_width: width of the hysteresis loop along the command, for the kinds of memory [cmd].
        seed: of the resampling.
        ordered: whether the trials stand in the order of recording.

    Raises:
        GapError: if there is no trial, residuals do not fit the trials or are not finite, or all are zero.
        LogError: if a trial is not uniform.
    """
    if not trials:
        raise GapError("no trial given, expected one or more")
    require_residuals(trials, residuals)
    power = np.concatenate([e**2 for e in residuals])
    if power.sum() <= 0:
        raise GapError(f"all {power.size} residuals are zero, expected something to localise")
    labels = np.concatenate([place_labels(trial) for trial in trials])
    return Localisation(
        places=_places(power, labels, _blocks(residuals, trials[0].dt), seed),
        spectrum=spectrum_of(trials, residuals),
        memory=memory_gains(trials, residuals, loop_width, ordered),
    )


def place_labels(trial: Trial) -> Index:
    """Number in `PLACES` of every sample (T,) of a uniform trial.

    `hold`: the command rests. `first_flexure`: it moves, and has not turned yet in this trial. `after_reversal`: it
    moves, and has travelled less than a tenth of its range since it turned. Else `loading` or `unloading`. The parts
    depend on the command alone, so that every simulator of a device is judged by the same ones.

    Raises:
        LogError: if the sampling is not uniform.
    """
    parts = command_segments(trial)
    k = np.arange(len(trial))
    labels = np.where(parts.labels == Motion.UNLOADING, PLACES.index("unloading"), PLACES.index("loading"))
    if parts.reversals.size:
        width = _AFTER * float(np.ptp(trial.command))
        turned = np.zeros(len(trial), dtype=np.bool_)
        turned[parts.reversals] = True
        last = np.maximum.accumulate(np.where(turned, k, -1))
        travelled = np.cumsum(np.abs(np.diff(trial.command, prepend=trial.command[0])))
        near = (last >= 0) & (travelled - travelled[np.maximum(last, 0)] < width) & (k > last)
        labels[near] = PLACES.index("after_reversal")
        labels[: int(parts.reversals[0]) + 1] = PLACES.index("first_flexure")
    else:
        labels[:] = PLACES.index("first_flexure")
    labels[parts.labels == Motion.HOLD] = PLACES.index("hold")
    return labels.astype(np.intp)


def _blocks(residuals: Sequence[Vec], dt: float) -> Index:
    """Number of the block of every sample of all trials; no block reaches over two trials."""
    samples = sum(e.size for e in residuals)
    length = max(_BLOCK_S, 4 * _correlation_s(residuals, dt)) / dt
    length = max(1, round(min(length, samples / _LEAST_BLOCKS)))
    numbers, first = [], 0
    for e in residuals:
        count = max(1, round(e.size / length))
        numbers.append(first + np.arange(e.size) * count // e.size)
        first += count
    return np.concatenate(numbers)


def _correlation_s(residuals: Sequence[Vec], dt: float) -> float:
    """Lag at which the correlation of the residuals, about each one's mean, falls to 1/e [s]."""
    longest = max(e.size for e in residuals)
    size = 2 ** math.ceil(math.log2(2 * longest))
    total = np.zeros(longest)
    for e in residuals:
        shape = np.abs(np.fft.rfft(e - e.mean(), size)) ** 2
        total += np.fft.irfft(shape, size)[:longest]
    below = np.flatnonzero(total < total[0] / math.e)
    return float(below[0]) * dt if below.size else longest * dt


def _places(power: Vec, labels: Index, blocks: Index, seed: int) -> dict[str, Place]:
    energy = np.zeros((int(blocks[-1]) + 1, len(PLACES)))
    spent = np.zeros_like(energy)
    np.add.at(energy, (blocks, labels), power)
    np.add.at(spent, (blocks, labels), 1.0)
    share = energy.sum(axis=0) / power.sum()
    time = spent.sum(axis=0) / labels.size
    random = np.random.default_rng(seed)
    weights = random.multinomial(len(energy), np.full(len(energy), 1 / len(energy)), size=_RESAMPLES)
    drawn, seconds = weights @ energy, weights @ spent
    # The time in each part is given by the motion, so that only the density is resampled.
    drawn = time * np.divide(drawn, seconds, out=np.zeros_like(drawn), where=seconds > 0)
    totals = np.maximum(drawn.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    low, high = np.quantile(drawn / totals, [0.05, 0.95], axis=0).tolist()
    return {
        name: Place(float(share[k]), float(share[k] / time[k]), (low[k], high[k]))
        for k, name in enumerate(PLACES)
        if time[k] > 0
    }

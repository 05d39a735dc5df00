"""Repeats of a motion within and across trials: where the command does the same again, the tip should, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Vec

from .motion_type import command_segments
from .white_noise import white_noise

TOLERANCE = 0.01
"""Commands are equal where they differ by less than this share of their range."""

_LEAST_S = 2.0  # a shorter repeat says little on a floor
_LEAST_SPAN = 0.3  # of the range of all commands
_LEAST_SHIFT_S = 0.5
_MOST_SHIFTS = 40  # per pair of trials, best supported first


@dataclass(frozen=True)
class Repeat:
    """Two stretches with equal commands.

    Attributes:
        first, second: numbers of the trials; equal within one trial.
        start, stop: samples of the first trial, stop exclusive.
        shift: where the second stretch lies: sample k of the first trial is sample k + shift of the second; fractions
            of a sample are alignment.
    """

    first: int
    second: int
    start: int
    stop: int
    shift: float

    def differences(self, signals: Sequence[Vec]) -> tuple[Vec, float]:
        """Second less first stretch of one signal per trial, (T,) each; and the variance of white noise in it, over
        that in the signal: interpolation to fractions of a sample evens some of it out."""
        whole = int(np.floor(self.shift))
        part = self.shift - whole
        later = signals[self.second][self.start + whole : self.stop + whole]
        if part > 0:
            later = (1 - part) * later + part * signals[self.second][self.start + whole + 1 : self.stop + whole + 1]
        return later - signals[self.first][self.start : self.stop], 1 + part**2 + (1 - part) ** 2


def find_repeats(trials: Sequence[Trial], tolerance: float = TOLERANCE) -> tuple[Repeat, ...]:
    """All pairs of stretches of uniform trials at one rate whose commands are equal.

    Turning points and ends of holds at equal levels propose the shifts. A stretch counts from where it has visited both
    its extremes, since a hysteresis has then forgotten what was before (wiping-out, for loops that fit between them);
    it is at least 2 s long and covers 30 % of the range of all commands.

    Args:
        trials: in recording order.
        tolerance: greatest difference of equal commands, relative to the range of all.

    Raises:
        LogError: if a trial is not uniform.
    """
    if not trials:
        return ()
    span = max(float(t.command.max()) for t in trials) - min(float(t.command.min()) for t in trials)
    if span <= 0:
        return ()
    noise = white_noise([trial.command for trial in trials])
    band = max(tolerance * span, 4 * 2**0.5 * noise)
    marks = [_marks(trial) for trial in trials]
    found: list[Repeat] = []
    for a, first in enumerate(trials):
        for b in range(a, len(trials)):
            for shift in _shifts(first, trials[b], marks[a], marks[b], band, a == b):
                repeat = _stretch((a, b), (first, trials[b]), shift, band, _LEAST_SPAN * span)
                if repeat and not any(_same(repeat, other) for other in found):
                    found.append(repeat)
    return tuple(found)


def _marks(trial: Trial) -> Index:
    parts = command_segments(trial)
    return np.unique(np.concatenate([parts.reversals, [b - 1 for _, b in parts.holds], [0]]).astype(np.intp))


def _shifts(first: Trial, second: Trial, a: Index, b: Index, band: float, same: bool) -> list[int]:
    """Shifts that bring at least two marks onto marks of equal level, best supported first."""
    equal = np.abs(first.command[a][:, None] - second.command[b][None, :]) <= 2 * band
    shifts = (b[None, :] - a[:, None])[equal]
    if same:
        shifts = shifts[shifts * first.dt >= _LEAST_SHIFT_S]
    values, votes = np.unique(shifts, return_counts=True)
    counted = np.concatenate([[0], np.cumsum(votes)])
    near = np.searchsorted(values, values + 2, side="right"), np.searchsorted(values, values - 2)
    support = counted[near[0]] - counted[near[1]]
    order = np.argsort(-support, kind="stable")
    return [int(values[k]) for k in order if support[k] >= 2][:_MOST_SHIFTS]


def _stretch(
    pair: tuple[int, int], trials: tuple[Trial, Trial], shift: int, band: float, least: float
) -> Repeat | None:
    """The longest equal stretch at about that shift, the shift refined to a fraction of a sample."""
    u, v = trials[0].command, trials[1].command
    start, stop = _longest(np.abs(_shifted(v, shift, u.size) - u) <= 4 * band)
    if (stop - start) * trials[0].dt < _LEAST_S:
        return None
    slope = np.gradient(v)[start + shift : stop + shift]
    power = float(slope @ slope)
    lead = float(slope @ (u[start:stop] - v[start + shift : stop + shift])) / power if power > 0 else 0.0
    exact = shift + float(np.clip(lead, -1.5, 1.5))
    exact = round(exact) if abs(exact - round(exact)) < 0.02 else exact
    start, stop = _longest(np.abs(_shifted(v, exact, u.size) - u) <= band)
    if stop <= start or np.ptp(u[start:stop]) < least:
        return None
    start += max(int(np.argmax(u[start:stop])), int(np.argmin(u[start:stop])))
    if (stop - start) * trials[0].dt < _LEAST_S:
        return None
    return Repeat(*pair, start, stop, float(exact))


def _shifted(v: Vec, shift: float, size: int) -> Vec:
    """v at k + shift for k = 0 ... size - 1, not-a-number outside."""
    return np.interp(np.arange(size) + shift, np.arange(v.size), v, left=np.nan, right=np.nan)


def _longest(inside: NDArray[np.bool_]) -> tuple[int, int]:
    edges = np.diff(np.concatenate(([0], inside.astype(np.int8), [0])))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not starts.size:
        return 0, 0
    k = int(np.argmax(stops - starts))
    return int(starts[k]), int(stops[k])


def _same(a: Repeat, b: Repeat) -> bool:
    return (a.first, a.second) == (b.first, b.second) and abs(a.shift - b.shift) < 3

"""Noise floor: irreducible error of any simulator, from repeated motions or from the noise of the residual."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.clocks import runs
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Mask, Vec

from ..diagnosis import FloorKind
from .motion_type import command_segments
from .sensor import white_noise

TOLERANCE = 0.01
"""Share of the range within which two commands count as equal."""

_LEAST_REPEATED_S = 5.0  # of repeats in all, for a floor from repeats
_LEAST_S = 2.0  # of one repeat
_LEAST_SPAN = 0.3  # of the range of all commands
_LEAST_SHIFT_S = 0.5
_MOST_SHIFTS = 40  # per pair of trials, best supported first


@dataclass(frozen=True)
class NoiseFloor:
    """Root mean square error of the best simulator.

    Attributes:
        rmse_deg: from repeats if there are any, otherwise the noise [deg].
        kind: origin of that value.
        noise_deg: white noise of the residual [deg]; unlike differences between repeats it excludes a heartbeat, drift
            and other motion not locked to the command.
    """

    rmse_deg: float
    kind: FloorKind
    noise_deg: float


@dataclass(frozen=True)
class RepeatedMotion:
    """Pair of parts of trials with equal commands.

    Attributes:
        first, second: numbers of the trials; equal within one trial.
        start, stop: samples of the first trial, stop exclusive.
        shift: sample k of the first trial corresponds to sample k + shift of the second, fractions included.
    """

    first: int
    second: int
    start: int
    stop: int
    shift: float

    def differences(self, signals: Sequence[Vec]) -> tuple[Vec, float]:
        """Difference of a signal (T,) between the parts, and its noise variance over the signal's (at most 2)."""
        whole = int(np.floor(self.shift))
        part = self.shift - whole
        later = signals[self.second][self.start + whole : self.stop + whole]
        if part > 0:
            later = (1 - part) * later + part * signals[self.second][self.start + whole + 1 : self.stop + whole + 1]
        return later - signals[self.first][self.start : self.stop], 1 + part**2 + (1 - part) ** 2


def find_floor(
    trials: Sequence[Trial], residuals: Sequence[Vec], dt: float, repeats: Sequence[RepeatedMotion] | None = None
) -> NoiseFloor:
    """Noise floor of uniform trials, from repeated motions and from white noise.

    From repeats: sigma^2 = sum_p sum_k (e2 - e1)^2 / sum_p n_p w_p over pairs p of n_p samples, with w = 2 at a shift
    of whole samples, less if interpolation reduces the noise. Residuals, not angles, are compared, since commands of
    repeats may differ by 1 % of their range.
    """
    noise = white_noise(residuals)
    pairs = find_repeats(trials) if repeats is None else repeats
    if sum(repeat.stop - repeat.start for repeat in pairs) * dt < _LEAST_REPEATED_S:
        return NoiseFloor(noise, "noise", noise)
    differences = [repeat.differences(residuals) for repeat in pairs]
    squares = np.array([float(d @ d) for d, _ in differences])
    weights = np.array([d.size * w for d, w in differences])
    return NoiseFloor(math.sqrt(float(squares.sum() / weights.sum())), "repeats", noise)


def find_repeats(trials: Sequence[Trial]) -> tuple[RepeatedMotion, ...]:
    """Find all pairs of stretches with equal commands in uniform trials at one rate.

    Turning points and ends of holds at equal levels give candidate shifts. A stretch counts from its visit to both
    extremes on, since hysteresis has then lost its earlier memory (wiping-out property). It is at least 2 s long and
    covers 30 % of the range of all commands.
    """
    if not trials:
        return ()
    span = max(float(t.command.max()) for t in trials) - min(float(t.command.min()) for t in trials)
    if span <= 0:
        return ()
    noise = white_noise([trial.command for trial in trials])
    band = max(TOLERANCE * span, 4 * 2**0.5 * noise)
    segments = [command_segments(trial) for trial in trials]
    marks = [
        np.unique(np.concatenate([parts.reversals, [b - 1 for _, b in parts.holds], [0]]).astype(np.intp))
        for parts in segments
    ]
    repeats: list[RepeatedMotion] = []
    for a, first in enumerate(trials):
        for b in range(a, len(trials)):
            for shift in _shifts(first, trials[b], marks[a], marks[b], band, a == b):
                repeat = _longest_repeat((a, b), (first, trials[b]), shift, band, _LEAST_SPAN * span)
                if repeat and not any(_same_repeat(repeat, other) for other in repeats):
                    repeats.append(repeat)
    return tuple(repeats)


def _shifts(first: Trial, second: Trial, a: Index, b: Index, band: float, same: bool) -> list[int]:
    """Candidate shifts that align at least two marks of equal level; best supported first."""
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


def _longest_repeat(
    pair: tuple[int, int], trials: tuple[Trial, Trial], shift: int, band: float, least: float
) -> RepeatedMotion | None:
    """Longest stretch of two equal commands near a given time shift, and the shift refined within a sample."""
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
    return RepeatedMotion(*pair, start, stop, float(exact))


def _shifted(v: Vec, shift: float, size: int) -> Vec:
    """Signal v at k + shift for k = 0 ... size - 1, not-a-number outside."""
    return np.interp(np.arange(size) + shift, np.arange(v.size), v, left=np.nan, right=np.nan)


def _longest(inside: Mask) -> tuple[int, int]:
    """First and last sample (exclusive) of the longest run of true values; (0, 0) without one."""
    starts, stops = runs(inside)
    k = int(np.argmax(stops - starts)) if starts.size else 0
    return (int(starts[k]), int(stops[k])) if starts.size else (0, 0)


def _same_repeat(a: RepeatedMotion, b: RepeatedMotion) -> bool:
    return (a.first, a.second) == (b.first, b.second) and abs(a.shift - b.shift) < 3

"""The residual by frequency: bands, coherence with the command, its harmonics, and lines that are not the command's."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import csd, get_window, welch
from scipy.stats import norm

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Mask, Vec

from .memory import locked_part

BANDS_HZ = (0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 25.0)
"""Edges of the bands [Hz]."""

_SEGMENT_S = 8.0  # of the averaged spectra; resolves 0.25 Hz with a Hann window
_PURE = 0.5  # of the command's energy within one line: then it has a fundamental frequency
_HARMONICS = 8
_WIDE = 2.0  # bins on either side that a Hann window spreads a line over
_NEIGHBOURS_HZ, _LEAST_NEIGHBOURS = 0.6, 15  # width and bins of the median that a line stands out from
_LOWEST_HZ = 0.12
_CHANCE = 1e-4  # of one false line in all frequencies
_LEAST_SHARE = 0.005
_SPOKEN = 1e-3  # of the command's largest bin (3 % in amplitude): a line there may be the command's
_PEAK = 6.0  # and it stands out there by that; a broad spectrum says nothing on one frequency
_SPARSE = 8.0  # bins between harmonics, below which they would take up every frequency
_STANDS_OUT = 3.0  # over its surroundings, in half of the trials: noise does in an eighth of them


@dataclass(frozen=True)
class Line:
    """A sharp line of the residual that the command does not have.

    Attributes:
        hz: frequency [Hz].
        share: of the residual's energy about its mean.
        ratio: height over its surroundings, geometric mean over the trials.
    """

    hz: float
    share: float
    ratio: float


@dataclass(frozen=True)
class Spectrum:
    """The residual of all trials by frequency, about each trial's mean.

    Attributes:
        bands: lower and upper edge [Hz] and share of the energy.
        coherent: share of the energy that is linear in the command, by coherence.
        harmonics: share at multiples of the command's fundamental frequency, of the trials that have one; the first
            is the fundamental itself. Empty where no trial has one.
        lines: sharp lines not locked to the command, strongest first.
    """

    bands: tuple[tuple[float, float, float], ...]
    coherent: float
    harmonics: tuple[float, ...]
    lines: tuple[Line, ...]


@dataclass(frozen=True, eq=False)
class _Shown:
    """One trial's periodograms on its own grid, Hann window: frequencies, residual, the residual less its part that is
    locked to the command, command, and the command's fundamental."""

    hz: Vec
    power: Vec
    free: Vec
    command: Vec
    fundamental: float

    @property
    def bin_hz(self) -> float:
        return float(self.hz[1])


def spectrum_of(trials: Sequence[Trial], residuals: Sequence[Vec]) -> Spectrum:
    """Spectrum of residuals (T,) [deg] of uniform trials at one rate."""
    locked = locked_part(trials, residuals)
    shown = [_show(*each) for each in zip(trials, residuals, locked, strict=True) if each[1].size >= 32]
    total = sum(float(s.power.sum()) for s in shown)
    if total <= 0:
        return Spectrum(tuple((a, b, 0.0) for a, b in _bands(trials)), 0.0, (), ())
    bands = [
        (a, b, sum(float(s.power[(s.hz >= a) & (s.hz < b)].sum()) for s in shown) / total) for a, b in _bands(trials)
    ]
    return Spectrum(tuple(bands), _coherent(trials, residuals), _harmonics(shown), _lines(shown, total))


def _bands(trials: Sequence[Trial]) -> list[tuple[float, float]]:
    nyquist = 0.5 / trials[0].dt * (1 + 1e-9)
    edges = [edge for edge in BANDS_HZ if edge < 0.99 * nyquist] + [nyquist]
    return list(itertools.pairwise(edges))


def _show(trial: Trial, e: Vec, locked: Vec) -> _Shown:
    window = get_window("hann", e.size)
    hz = np.asarray(np.fft.rfftfreq(e.size, trial.dt), dtype=np.float64)
    power, free = (np.abs(np.fft.rfft(window * (x - x.mean()))) ** 2 for x in (e, e - locked))
    u = trial.command - trial.command.mean()
    command = np.abs(np.fft.rfft(window * u)) ** 2
    command[0] = 0.0
    top = int(np.argmax(command))
    near = command[max(top - 2, 0) : top + 3]
    if near.sum() < _PURE * command.sum() or near.sum() <= 0:
        return _Shown(hz, power, free, command, 0.0)
    return _Shown(hz, power, free, command, float(near @ hz[max(top - 2, 0) : top + 3] / near.sum()))


def _coherent(trials: Sequence[Trial], residuals: Sequence[Vec]) -> float:
    """Share of energy coherent with the command: sum C S_ee / sum S_ee, C = |S_ue|^2 / (S_uu S_ee), less its bias."""
    rate = 1.0 / trials[0].dt
    size = min(round(_SEGMENT_S * rate), *(max(len(t) // 2, 8) for t in trials))
    sums = [np.zeros(size // 2 + 1, dtype=np.complex128) for _ in range(3)]
    count = 0.0
    for trial, e in zip(trials, residuals, strict=True):
        segments = max(1, 2 * len(trial) // size - 1)
        count += segments
        for k, (a, b) in enumerate(((trial.command, e), (trial.command, trial.command), (e, e))):
            density = csd(a, b, rate, nperseg=size)[1] if k == 0 else welch(a, rate, nperseg=size)[1]
            sums[k] += segments * density
    cross, command, residual = np.abs(sums[0]) ** 2, sums[1].real, sums[2].real
    coherence = np.divide(cross, command * residual, out=np.zeros(cross.size), where=command * residual > 0)
    # Of n independent segments, half of those that overlap by half, unrelated signals have a coherence of 1 / n.
    bias = min(1.0 / max(0.5 * (count + 1), 1.0), 0.99)
    coherence = np.clip((coherence - bias) / (1 - bias), 0.0, 1.0)
    return float(coherence @ residual / residual.sum()) if residual.sum() > 0 else 0.0


def _harmonics(shown: Sequence[_Shown]) -> tuple[float, ...]:
    pure = [s for s in shown if s.fundamental > 0]
    energy = sum(float(s.power.sum()) for s in pure)
    if energy <= 0:
        return ()
    found = [
        sum(float(s.power[np.abs(s.hz - k * s.fundamental) <= _WIDE * s.bin_hz].sum()) for s in pure) / energy
        for k in range(1, _HARMONICS + 1)
    ]
    return tuple(found)


def _lines(shown: Sequence[_Shown], total: float) -> tuple[Line, ...]:
    """Frequencies at which the power of the free part over its surroundings, mean over trials, is beyond chance.

    What the command's past explains over all trials is taken out first: periodic motions have lines, too. Of a residual
    without lines the ratio of power to its local median is exponential over ln 2; its logarithm has mean
    -0.5772 - ln ln 2 and variance pi^2 / 6, and the mean of n trials is nearly normal. The geometric mean, unlike the
    arithmetic, does not rise by one trial.
    """
    finest = min(s.bin_hz for s in shown)
    grid = np.arange(_LOWEST_HZ, max(s.hz[-1] for s in shown) - finest, finest)
    if grid.size < _LEAST_NEIGHBOURS:
        return ()
    ratios = np.array([np.interp(grid, s.hz, _ratio(s.free, s.bin_hz)) for s in shown])
    free = np.array([~_commanded(s, grid) for s in shown])
    count = free.sum(axis=0)
    n = np.maximum(count, 1)
    logs = (np.log(np.maximum(ratios, 1e-6)) * free).sum(axis=0) / n
    mean = np.where(count > 0, np.exp(logs), 0.0)
    usual = -np.euler_gamma - np.log(np.log(2))
    bar = np.exp(usual + norm.isf(_CHANCE / grid.size) * np.pi / np.sqrt(6 * n))
    lines: list[Line] = []
    common = ((ratios > _STANDS_OUT) & free).sum(axis=0) >= 0.5 * n
    left = (mean > bar) & common & (count >= 0.5 * len(shown))
    while left.any() and len(lines) < _HARMONICS:
        k = int(np.argmax(np.where(left, mean, 0.0)))
        share = float(sum(_above(s, float(grid[k])) for s in shown)) / total
        if share >= _LEAST_SHARE:
            lines.append(Line(float(grid[k]), share, float(mean[k])))
        left &= np.abs(grid - grid[k]) > 2 * _WIDE * max(s.bin_hz for s in shown)
    return tuple(sorted(lines, key=lambda line: -line.share))


def _ratio(power: Vec, bin_hz: float) -> Vec:
    """Power over its local median."""
    size = 2 * max(_LEAST_NEIGHBOURS // 2, round(0.5 * _NEIGHBOURS_HZ / bin_hz)) + 1
    level = median_filter(power, size=size, mode="nearest")
    return power / np.maximum(level, 1e-12 * max(float(power.max()), 1e-300))


def _commanded(s: _Shown, grid: Vec) -> Mask:
    """Where the command speaks itself, or a harmonic of it may."""
    loud = (s.command > _SPOKEN * float(s.command.max())) & (_ratio(s.command, s.bin_hz) > _PEAK)
    loud |= np.roll(loud, 1) | np.roll(loud, -1)
    spoken = np.interp(grid, s.hz, loud.astype(np.float64)) > 0
    if s.fundamental > _SPARSE * s.bin_hz:
        order = np.rint(grid / s.fundamental)
        near = np.abs(grid - order * s.fundamental) <= _WIDE * s.bin_hz
        spoken |= near & (order <= 4 * _HARMONICS)
    return spoken


def _above(s: _Shown, hz: float) -> float:
    """Energy of a line over its surroundings, whose level is the geometric mean of that on either side."""
    off = s.hz - hz
    inside, reach = np.abs(off) <= _WIDE * s.bin_hz, 4 * _WIDE * s.bin_hz
    sides = [s.free[side & (np.abs(off) <= reach) & ~inside] for side in (off < 0, off > 0)]
    levels = [float(np.median(side)) / np.log(2) for side in sides if side.size]
    level = float(np.exp(np.mean(np.log(np.maximum(levels, 1e-300))))) if levels else 0.0
    return max(float(s.free[inside].sum()) - level * int(inside.sum()), 0.0)

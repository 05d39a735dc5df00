"""Analysis of a residual: memory of the command's past, spectral lines, and energy by part of the motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import csd, get_window, welch
from scipy.stats import norm

from hystmpc.models.identify.motion_lines import fundamental_hz
from hystmpc.trials.segments import Motion, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Mask, Mat, Vec

from .diagnosis import ResidualShare
from .logs.motion_type import MEMORIES, command_segments, memory_features, past_features, play_states, since_reversal
from .logs.sensor import autocorrelation

_RIDGES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)  # of the mean eigenvalue of the features' Gram matrix
_RIDGE = 1e-3
_RANDOM = 160  # random features
_HALF_WIDTHS, _PLAYS = (0.005, 0.2), 8  # of the command's range
_STIFF = (1e-6, 1e-5, 1e-4, 1e-3)  # ridges for plays, which resemble each other
_PARTS = 4  # a single trial is cut into


def memory_gains(
    trials: Sequence[Trial], residuals: Sequence[Vec], loop_width: float, ordered: bool = True
) -> dict[str, float]:
    """Share of the residual's energy about its mean that each memory explains held out, by name; below 0 if none.

    Ridge regression over all trials but one, applied to that one. The features are speed (|v|, v, sign), time since the
    last reversal and age of the hold (decaying exponentials times the last direction), travel since the reversal (in
    loop widths) and in total, and the clock. A single trial is cut into four.

    Args:
        ordered: whether the trials are in recording order; if not, the clock restarts in each.
    """
    clocks = np.concatenate([[0.0], np.cumsum([trial.duration_s if ordered else 0.0 for trial in trials])])
    features = [memory_features(trial, loop_width, float(t)) for trial, t in zip(trials, clocks[:-1], strict=True)]
    targets = _folded(residuals)
    total = float(_held_out([np.zeros((y.size, 0)) for y in targets], targets, (_RIDGE,)).sum())
    gains = {}
    for name in MEMORIES:
        missed = _held_out(_folded([trial_features[name] for trial_features in features]), targets, (_RIDGE,))[0]
        gains[name] = float(np.clip(1 - missed.sum() / total, -1.0, 1.0)) if total > 0 else 0.0
    return gains


def explainable_share(trials: Sequence[Trial], residuals: Sequence[Vec], seed: int = 0) -> float:
    """Share of the residual's energy that a flexible model of the command's past explains held out, 0 to 1.

    Leave-one-trial-out ridge regression on lagged commands, speeds, play states of six widths, commands low-passed at
    five time constants, and `tanh` of random mixtures of these. For each trial, the ridge and the use of random
    features are chosen on the others. A trial with an increased error counts as unexplained.
    """
    targets = _folded(residuals)
    energies = np.array([float(y @ y) for y in targets])
    energy = float(energies.sum())
    if energy <= 0:
        return 0.0
    plain = _folded(past_features(trials))
    size = plain[0].shape[1]
    random = np.random.default_rng(seed)
    mixing = random.standard_normal((size, _RANDOM)) / np.sqrt(size)
    phase = random.uniform(-1.5, 1.5, _RANDOM)

    def mixed(x: Mat) -> Mat:
        return np.concatenate([x, np.tanh(1.5 * x @ mixing + phase)], axis=1)

    missed = np.concatenate([_held_out(plain, targets, _RIDGES), _held_out(plain, targets, _RIDGES, mixed)])
    others = missed.sum(axis=1, keepdims=True) - missed
    chosen = np.argmin(others, axis=0)
    explained = 1 - float(np.minimum(missed[chosen, np.arange(len(targets))], energies).sum()) / energy
    return float(np.clip(explained, 0.0, 1.0))


def friction_share(trials: Sequence[Trial], residuals: Sequence[Vec], noise_deg: float) -> float:
    """Share of the residual's energy above the noise that plays of the command explain held out, 0 to 1.

        r = c + a_0 u + sum_i a_i z_i,  z_i the plays of half-widths from 0.5 to 20 % of the command's range

    is the change by other weights and widths of a Prandtl-Ishlinskii model. Ridge regression, each trial left out once
    and weighted by its RMS; samples before its first reversal do not count. Of three initial states of the plays (after
    a fall, after a rise, no earlier motion) the best counts.
    """
    starts = [int(next(iter(segment(trial).reversals), 0)) for trial in trials]
    targets = _folded([error[k:] for error, k in zip(residuals, starts, strict=True)])
    energies = np.array([float(y @ y) for y in targets])
    weights = 1 / np.sqrt(np.maximum(energies, np.finfo(np.float64).tiny))
    energy = float(energies @ weights)
    noise = noise_deg**2 * float(np.array([y.size for y in targets]) @ weights)
    if energy <= noise:
        return 0.0
    span = max(float(np.ptp(trial.command)) for trial in trials) or 1.0
    half = span * np.geomspace(*_HALF_WIDTHS, _PLAYS)
    missed = []
    for side in (-1.0, 0.0, 1.0):
        rows = [
            np.column_stack([trial.command, play_states(trial.command, half, side)])[k:] / span
            for trial, k in zip(trials, starts, strict=True)
        ]
        missed.append(float((_held_out(_folded(rows), targets, _STIFF) @ weights).min()))
    return float(np.clip((energy - min(missed)) / (energy - noise), 0.0, 1.0))


def locked_part(trials: Sequence[Trial], residuals: Sequence[Vec]) -> list[Vec]:
    """Part of the residuals (T,) that `past_features` explain by one ridge fit over all trials."""
    rows = [_with_one(x) for x in past_features(trials)]
    gram = np.sum([x.T @ x for x in rows], axis=0)
    product = np.sum([x.T @ e for x, e in zip(rows, residuals, strict=True)], axis=0)
    ridge = _RIDGE * float(np.trace(gram)) / len(gram) * np.eye(len(gram))
    weights = np.linalg.solve(gram + ridge, product)
    return [x @ weights for x in rows]


def _folded(signals: Sequence[Mat]) -> list[Mat]:
    if len(signals) > 1:
        return list(signals)
    edges = np.linspace(0, len(signals[0]), _PARTS + 1).astype(np.intp)
    return np.split(signals[0], edges[1:-1])


def _held_out(
    rows: Sequence[Mat], targets: Sequence[Vec], ridges: Sequence[float], more: Callable[[Mat], Mat] | None = None
) -> Mat:
    """Squared errors (ridges, folds) of ridge fits to the other folds; `more` adds features by fold to save memory."""

    def features(k: int) -> Mat:
        return _with_one(rows[k] if more is None else more(rows[k]))

    moments = []
    for k, y in enumerate(targets):
        x = features(k)
        moments.append((x.T @ x, x.T @ y))
    gram, product = (np.sum([m[j] for m in moments], axis=0) for j in (0, 1))
    missed = np.empty((len(ridges), len(rows)))
    for k in range(len(rows)):
        rest = gram - moments[k][0]
        scale, turn = np.linalg.eigh(rest)
        seen = turn.T @ (product - moments[k][1])
        shown = features(k) @ turn
        for j, ridge in enumerate(ridges):
            damped = np.maximum(scale, 0.0) + ridge * float(np.mean(np.maximum(scale, 0.0)))
            missed[j, k] = float(np.sum((targets[k] - shown @ (seen / damped)) ** 2))
    return missed


def _with_one(x: Mat) -> Mat:
    return np.concatenate([np.ones((len(x), 1)), x], axis=1)


_SEGMENT_S = 8.0  # of the averaged spectra; resolves 0.25 Hz with a Hann window
_HIGHEST_HARMONIC = 32
_MOST_LINES = 8
_WIDE = 2.0  # bins on either side that a Hann window spreads a line over
_NEIGHBOURS_HZ, _LEAST_NEIGHBOURS = 0.6, 15  # width and bins of the local median
_LOWEST_HZ = 0.12
_CHANCE = 1e-4  # of one false line in all frequencies
_LEAST_SHARE = 0.005
_COMMANDED = 1e-3  # of the command's largest bin (3 % in amplitude): a line there may be the command's
_PEAK = 6.0  # over the local median, for a line of the command
_SPARSE = 8.0  # bins between harmonics, below which they would exclude every frequency
_VISIBLE = 3.0  # over the local median, in half of the trials: noise exceeds it in an eighth of them


@dataclass(frozen=True)
class SpectralLine:
    """Sharp spectral line of the residual that is absent in the command.

    Attributes:
        share: of the residual's energy about its mean.
    """

    hz: float
    share: float


@dataclass(frozen=True)
class Spectrum:
    """Spectrum of the residual of all trials, about each trial's mean.

    Attributes:
        coherent: share of the energy that is linear in the command, by coherence.
    """

    coherent: float
    lines: tuple[SpectralLine, ...]


@dataclass(frozen=True, eq=False)
class _Periodograms:
    """Hann periodograms (F,) of the residual, its unlocked part and the command; command frequency [Hz] or 0."""

    hz: Vec
    power: Vec
    unlocked: Vec
    command: Vec
    fundamental: float

    @property
    def bin_hz(self) -> float:
        return float(self.hz[1])


def spectrum_of(trials: Sequence[Trial], residuals: Sequence[Vec]) -> Spectrum:
    """Spectrum of residuals (T,) [deg] of uniform trials at one rate."""
    locked = locked_part(trials, residuals)
    spectra = [_periodograms(*each) for each in zip(trials, residuals, locked, strict=True) if each[1].size >= 32]
    total = sum(float(s.power.sum()) for s in spectra)
    if total <= 0:
        return Spectrum(0.0, ())
    return Spectrum(_coherent(trials, residuals), _lines(spectra, total))


def _periodograms(trial: Trial, e: Vec, locked: Vec) -> _Periodograms:
    window = get_window("hann", e.size)
    hz = np.asarray(np.fft.rfftfreq(e.size, trial.dt), dtype=np.float64)
    power, unlocked = (np.abs(np.fft.rfft(window * (x - x.mean()))) ** 2 for x in (e, e - locked))
    u = trial.command - trial.command.mean()
    command = np.abs(np.fft.rfft(window * u)) ** 2
    command[0] = 0.0
    return _Periodograms(hz, power, unlocked, command, fundamental_hz(trial.command, trial.dt))


def _coherent(trials: Sequence[Trial], residuals: Sequence[Vec]) -> float:
    """Share of energy coherent with the command: sum C S_ee / sum S_ee, C = |S_ue|^2 / (S_uu S_ee), minus its bias."""
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
    # Unrelated signals have a coherence of 1 / n, with n independent segments: half of those that overlap by half.
    bias = min(1.0 / max(0.5 * (count + 1), 1.0), 0.99)
    coherence = np.clip((coherence - bias) / (1 - bias), 0.0, 1.0)
    return float(coherence @ residual / residual.sum()) if residual.sum() > 0 else 0.0


def _lines(shown: Sequence[_Periodograms], total: float) -> tuple[SpectralLine, ...]:
    """Frequencies at which the unlocked power over its local median, averaged over trials, is significant.

    Without lines that ratio is exponential over ln 2; its logarithm has mean -0.5772 - ln ln 2 and variance pi^2 / 6.
    """
    finest = min(s.bin_hz for s in shown)
    grid = np.arange(_LOWEST_HZ, max(s.hz[-1] for s in shown) - finest, finest)
    if grid.size < _LEAST_NEIGHBOURS:
        return ()
    ratios = np.array([np.interp(grid, s.hz, _ratio(s.unlocked, s.bin_hz)) for s in shown])
    free = np.array([~_commanded(s, grid) for s in shown])
    count = free.sum(axis=0)
    n = np.maximum(count, 1)
    logs = (np.log(np.maximum(ratios, 1e-6)) * free).sum(axis=0) / n
    mean = np.where(count > 0, np.exp(logs), 0.0)
    usual = -np.euler_gamma - np.log(np.log(2))
    bar = np.exp(usual + norm.isf(_CHANCE / grid.size) * np.pi / np.sqrt(6 * n))
    lines: list[SpectralLine] = []
    common = ((ratios > _VISIBLE) & free).sum(axis=0) >= 0.5 * n
    left = (mean > bar) & common & (count >= 0.5 * len(shown))
    while left.any() and len(lines) < _MOST_LINES:
        k = int(np.argmax(np.where(left, mean, 0.0)))
        share = float(sum(_line_energy(s, float(grid[k])) for s in shown)) / total
        if share >= _LEAST_SHARE:
            lines.append(SpectralLine(float(grid[k]), share))
        left &= np.abs(grid - grid[k]) > 2 * _WIDE * max(s.bin_hz for s in shown)
    return tuple(sorted(lines, key=lambda line: -line.share))


def _ratio(power: Vec, bin_hz: float) -> Vec:
    size = 2 * max(_LEAST_NEIGHBOURS // 2, round(0.5 * _NEIGHBOURS_HZ / bin_hz)) + 1
    level = median_filter(power, size=size, mode="nearest")
    return power / np.maximum(level, 1e-12 * max(float(power.max()), 1e-300))


def _commanded(s: _Periodograms, grid: Vec) -> Mask:
    """Mask of frequencies of spectral lines of the command, and of harmonics of its fundamental."""
    peaks = (s.command > _COMMANDED * float(s.command.max())) & (_ratio(s.command, s.bin_hz) > _PEAK)
    peaks |= np.roll(peaks, 1) | np.roll(peaks, -1)
    commanded = np.interp(grid, s.hz, peaks.astype(np.float64)) > 0
    if s.fundamental > _SPARSE * s.bin_hz:
        order = np.rint(grid / s.fundamental)
        near = np.abs(grid - order * s.fundamental) <= _WIDE * s.bin_hz
        commanded |= near & (order <= _HIGHEST_HARMONIC)
    return commanded


def _line_energy(s: _Periodograms, hz: float) -> float:
    off = s.hz - hz
    inside, reach = np.abs(off) <= _WIDE * s.bin_hz, 4 * _WIDE * s.bin_hz
    sides = [s.unlocked[side & (np.abs(off) <= reach) & ~inside] for side in (off < 0, off > 0)]
    levels = [float(np.median(side)) / np.log(2) for side in sides if side.size]
    level = float(np.exp(np.mean(np.log(np.maximum(levels, 1e-300))))) if levels else 0.0
    return max(float(s.unlocked[inside].sum()) - level * int(inside.sum()), 0.0)


MOTION_PARTS = ("loading", "unloading", "after_reversal", "hold", "first_flexure")
"""Parts of a motion, exclusive; precedence: hold, first_flexure, after_reversal, direction."""

_AFTER = 0.1  # travel that counts as after a reversal, as a share of the command's range in the trial
_RESAMPLES = 500
_BLOCK_S, _LEAST_BLOCKS = 2.0, 10


@dataclass(frozen=True)
class Localisation:
    """Energy of the residual by part of the motion, frequency and memory.

    Attributes:
        places: per part of the motion; shares add up to one.
        memory: share that each kind of memory explains held out, by name; below zero if none.
    """

    places: Mapping[str, ResidualShare]
    spectrum: Spectrum
    memory: Mapping[str, float]


def localise(
    trials: Sequence[Trial], residuals: Sequence[Vec], loop_width: float, seed: int = 0, ordered: bool = True
) -> Localisation:
    """Share and density of the energy of residuals (T,) [deg] over parts of the motion, frequencies and memories.

    90 % intervals come from 500 resamples of blocks of time within trials: of 2 s or, if longer, four times the lag at
    which the residual's correlation falls to 1/e; ten blocks or more.
    """
    power = np.concatenate([e**2 for e in residuals])
    labels = np.concatenate([motion_part_labels(trial) for trial in trials])
    return Localisation(
        places=_residual_shares(power, labels, _blocks(residuals, trials[0].dt), seed),
        spectrum=spectrum_of(trials, residuals),
        memory=memory_gains(trials, residuals, loop_width, ordered),
    )


def motion_part_labels(trial: Trial) -> Index:
    """Number in `MOTION_PARTS` of every sample (T,) of a uniform trial.

    `hold`: the command rests. `first_flexure`: it moves, before its first turn in this trial. `after_reversal`: it
    moves, less than a tenth of its range after a turn. Otherwise `loading` or `unloading`. The parts depend on the
    command alone, so that they are the same for every simulator of a device.
    """
    parts = command_segments(trial)
    labels = np.where(parts.labels == Motion.UNLOADING, MOTION_PARTS.index("unloading"), MOTION_PARTS.index("loading"))
    if parts.reversals.size:
        width = _AFTER * float(np.ptp(trial.command))
        samples, travel, _ = since_reversal(trial.command, parts)
        labels[(samples > 0) & (travel < width)] = MOTION_PARTS.index("after_reversal")
        labels[: int(parts.reversals[0]) + 1] = MOTION_PARTS.index("first_flexure")
    else:
        labels[:] = MOTION_PARTS.index("first_flexure")
    labels[parts.labels == Motion.HOLD] = MOTION_PARTS.index("hold")
    return labels.astype(np.intp)


def _blocks(residuals: Sequence[Vec], dt: float) -> Index:
    """Block number of every sample of all trials; no block spans two trials."""
    samples = sum(e.size for e in residuals)
    longest = max(e.size for e in residuals)
    total = np.sum([autocorrelation(e - e.mean(), longest) for e in residuals], axis=0)
    below = np.flatnonzero(total < total[0] / math.e)  # lags from which the correlation is below 1/e
    lag_s = float(below[0]) * dt if below.size else longest * dt
    length = max(_BLOCK_S, 4 * lag_s) / dt
    length = max(1, round(min(length, samples / _LEAST_BLOCKS)))
    numbers, first = [], 0
    for e in residuals:
        count = max(1, round(e.size / length))
        numbers.append(first + np.arange(e.size) * count // e.size)
        first += count
    return np.concatenate(numbers)


def _residual_shares(power: Vec, labels: Index, blocks: Index, seed: int) -> dict[str, ResidualShare]:
    energy = np.zeros((int(blocks[-1]) + 1, len(MOTION_PARTS)))
    spent = np.zeros_like(energy)
    np.add.at(energy, (blocks, labels), power)
    np.add.at(spent, (blocks, labels), 1.0)
    share = energy.sum(axis=0) / power.sum()
    time = spent.sum(axis=0) / labels.size
    random = np.random.default_rng(seed)
    weights = random.multinomial(len(energy), np.full(len(energy), 1 / len(energy)), size=_RESAMPLES)
    drawn, seconds = weights @ energy, weights @ spent
    # The motion fixes the time in each part, so that only the density is resampled.
    drawn = time * np.divide(drawn, seconds, out=np.zeros_like(drawn), where=seconds > 0)
    totals = np.maximum(drawn.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    low, high = np.quantile(drawn / totals, [0.05, 0.95], axis=0).tolist()
    return {
        name: ResidualShare(float(share[k]), float(share[k] / time[k]), (low[k], high[k]))
        for k, name in enumerate(MOTION_PARTS)
        if time[k] > 0
    }

"""Faults of an angle sensor: resolution, white noise, spikes and held values; detection and repair."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.identify.estimation_noise import grid_step
from hystmpc.trials.clocks import runs
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Mask, Vec

_COARSE = 0.4  # rms of rounding over white noise, from which the resolution counts as a fault
_NOISY = 1.5  # over the nominal noise
_SPIKE = 6.0  # standard deviations of noise
_SHAPE = 0.2, 0.8  # of a spike's height: pull on its neighbours' second difference, exactly half without noise
_SPIKES, _SPIKE_RATE = 3, 0.001
_RESUMES = 5.0  # standard deviations of noise by which a held value jumps when it resumes
_HELD_STRETCHES, _HELD_RATE = 3, 0.003
_LEAST_JUMP = 0.003  # of the angle's range: smallest evaluated spike or jump
_JUMP = 1.6  # times the steps around it
_BY_CHANCE = 0.001  # runs of equal readings in a trial, as long or longer, that its noise gives: held ones are longer
_MOST_REPEATS = 0.3  # probability that two readings at rest are equal: above it a run of them is no evidence
_REAL_NOISE = 1e-4  # of the angle's range: less may be the curvature of a motion without noise
_STEPS = 3.0  # least spike or jump in steps of the grid
_SLOWEST_S = 0.05  # update interval of a tip tracker; a value that stays for longer is held
_ORDERS = (2, 3, 4)
_CLEARLY_LOWER = 0.93  # ratio to the lower order's estimate below which a higher, more scattered order is used
_KEPT = 0.8  # share of the differences, the smallest ones; the rest contains jumps, kinks and spikes
_KEPT_MOMENT = 0.43773  # E[z^2 | |z| < 1.28155] of a standard normal z: variance ratio of the smallest 80 %
_MOVING = 1e-4  # of the command's range per sample


@dataclass(frozen=True)
class SensorSigns:
    """Statistics of the angle sensor over trials as recorded.

    Attributes:
        quantisation_deg: step of the grid of the angles; 0 if there is none [deg].
        noise_deg: white noise, rounding included [deg].
        spike_rate: isolated spikes per sample.
        held_rate: share of samples that repeat the last value during a motion.
        coarse: whether rounding is a good part of the noise; a log written with few digits is on a grid, too.
        noisy: whether the noise exceeds the nominal noise by half; if that is unknown, whether it has spikes.
        spikes, drops: whether spikes and held values occur more often than by chance.
    """

    quantisation_deg: float
    noise_deg: float
    spike_rate: float
    held_rate: float
    coarse: bool
    noisy: bool
    spikes: bool
    drops: bool

    @property
    def energy(self) -> float:
        """Mean square error of noise and rounding [deg^2]; holds of a coarse sensor show no noise."""
        return max(self.noise_deg**2, self.quantisation_deg**2 / 12.0 if self.coarse else 0.0)


def sensor_signs(trials: Sequence[Trial], nominal_noise_deg: float | None = None) -> SensorSigns:
    """Detect faults of the sensor in trials as recorded, since resampling would remove the grid of the angles."""
    step = grid_step(np.concatenate([trial.angle for trial in trials]))
    noise = white_noise([trial.angle[:: _pace(trial)] for trial in trials])
    spikes = [_spikes(trial, step, noise) for trial in trials]
    held = [_held(trial, step, noise) for trial in trials]
    ticks = sum(len(trial) / _pace(trial) for trial in trials)
    count = sum(number for _, number in spikes)
    drops = sum(runs(mask)[0].size for mask in held)
    held_rate = sum(int(mask.sum()) for mask in held) / sum(len(trial) for trial in trials)
    spiked = count >= max(_SPIKES, _SPIKE_RATE * ticks)
    fine = nominal_noise_deg if nominal_noise_deg is not None else noise
    return SensorSigns(
        quantisation_deg=step,
        noise_deg=noise,
        spike_rate=count / ticks,
        held_rate=held_rate,
        coarse=step / math.sqrt(12) > _COARSE * max(fine, 1e-12) and step > 0,
        noisy=spiked if nominal_noise_deg is None else noise > _NOISY * nominal_noise_deg,
        spikes=spiked,
        drops=drops >= _HELD_STRETCHES and held_rate >= _HELD_RATE,
    )


def repaired(trial: Trial, signs: SensorSigns, simulated: Vec | None = None) -> Trial:
    """Replace spikes and held values of a trial by lines between their neighbours, or by simulated angles (T,) [deg].

    For a spike of one sample a line equals the local median, without lag on a moving angle. If the motion turns while a
    value is held, a line misses the turn; the simulated motion plus a line includes it.
    """
    angle = trial.angle.copy()
    mask = np.zeros(len(trial), dtype=np.bool_)
    if signs.spikes:
        mask |= _spikes(trial, signs.quantisation_deg, signs.noise_deg)[0]
    if signs.drops:
        mask |= _held(trial, signs.quantisation_deg, signs.noise_deg)
    if mask.any() and not mask.all():
        shape = np.zeros(len(trial)) if simulated is None else simulated
        angle[mask] = shape[mask] + np.interp(trial.t[mask], trial.t[~mask], (angle - shape)[~mask])
    return replace(trial, angle=angle)


def _pace(trial: Trial) -> int:
    """Log samples per update of a sensor slower than the log: the typical run of one value."""
    changes = np.flatnonzero(np.diff(trial.angle) != 0)
    if changes.size < 2:
        return 1
    typical = round(float(np.percentile(np.diff(changes), 25)))
    return typical if 1 < typical <= _SLOWEST_S / trial.dt else 1


def _spikes(trial: Trial, step: float, noise: float) -> tuple[Mask, int]:
    """Mask (T,) of samples that leave the line between their neighbours and return at once, and the number of spikes.

    With h_k = y_k - (y_{k-1} + y_{k+1}) / 2 a spike of height H gives h = -H/2, H, -H/2; a jump gives two neighbours of
    opposite sign, a bend neighbours of one sign.
    """
    values, edges = trial.angle, np.arange(len(trial))
    if _pace(trial) > 1:
        edges = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1])
        values = values[edges]
    mask = np.zeros(len(trial), dtype=np.bool_)
    if values.size < 5:
        return mask, 0
    h = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    least = max(_SPIKE * 1.5**0.5 * noise, _STEPS * step, _LEAST_JUMP * float(np.ptp(trial.angle)), 1e-9)
    middle, pull = h[1:-1], np.stack([h[:-2], h[2:]])
    safe = np.where(middle == 0, np.inf, middle)
    symmetric = (pull / safe <= -_SHAPE[0]) & (pull / safe >= -_SHAPE[1])
    spikes = np.flatnonzero((np.abs(middle) > least) & symmetric.all(axis=0)) + 2
    bounds = np.append(edges, len(trial))
    for k in spikes.tolist():
        mask[bounds[k] : bounds[k + 1]] = True
    return mask, spikes.size


def _held(trial: Trial, step: float, noise: float) -> Mask:
    """Mask of samples that repeat the last value before a large jump (not a dead zone), or longer than by chance."""
    angle, usual = trial.angle, _pace(trial)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(angle) != 0) + 1])
    lengths = np.diff(np.append(edges, angle.size))
    moving = np.abs(np.diff(trial.command)) > _MOVING * float(np.ptp(trial.command))
    least = max(_RESUMES * noise, _STEPS * step, _LEAST_JUMP * float(np.ptp(angle)))
    mask = np.zeros(angle.size, dtype=np.bool_)
    noisy = noise > _REAL_NOISE * float(np.ptp(angle))
    by_chance = usual * _longest_by_chance(lengths // usual, step, noise) if noisy else math.inf
    for k in np.flatnonzero(lengths[:-2] >= 2 * usual):
        start, stop = int(edges[k]), int(edges[k + 1])
        jump = abs(float(angle[stop] - angle[start]))
        around = abs(float(angle[edges[k + 2]] - angle[stop]))
        if k:
            around = max(around, abs(float(angle[start] - angle[edges[k - 1]])))
        resumes = jump > max(least, _JUMP * around + 2 * step + 3 * noise) and np.mean(moving[start : stop - 1]) >= 0.5
        if resumes or lengths[k] > by_chance:
            mask[start + usual : stop] = True
    return mask


def _longest_by_chance(runs: NDArray[np.int64], step: float, noise: float) -> float:
    """Length of the longest run of equal readings that noise on a grid explains; infinite if unknown.

    Two readings at rest are equal with p = step / (2 sqrt(pi) noise), L of them with p^(L - 1); the observed share of
    repeating runs also estimates p, even for coloured noise.
    """
    white = step / (2 * math.sqrt(math.pi) * noise) if noise > 0 else 1.0
    repeats = max(white, float(np.mean(runs > 1)), 1 / runs.size)
    return 1 + math.log(_BY_CHANCE / runs.size) / math.log(repeats) if repeats < _MOST_REPEATS else math.inf


def autocorrelation(signal: Vec, lags: int) -> Vec:
    """Sum over the samples of signal_k signal_{k + n} for n = 0 ... lags - 1 (N,), by FFT without wrapping around."""
    size = 2 ** math.ceil(math.log2(2 * max(signal.size, lags)))
    return np.asarray(np.fft.irfft(np.abs(np.fft.rfft(signal, size)) ** 2, size)[:lags])


def white_noise(signals: Sequence[Vec]) -> float:
    """Standard deviation of the white part of signals, each (T,), in their unit; 0 if all are too short.

    The n-th differences d of white noise have variance C(2n, n) sigma^2, those of a smooth motion almost none: sigma^2
    = mean(d^2 over the smaller 80 %) / (0.438 C(2n, n)) with n = 2, or 3 or 4 if these give at least 7 % less. A lower
    bound: noise that the sensor has filtered is underestimated.

    Source: von Neumann et al., Ann. Math. Stat. 12 (1941) 153, for n = 1; orders and trimming are ours.
    """
    lowest = math.inf
    for order in _ORDERS:
        parts = [np.abs(np.diff(signal, order)) for signal in signals if signal.size > order + 1]
        if not parts:
            break
        size = np.concatenate(parts)
        kept = np.sort(size)[: max(1, round(_KEPT * size.size))]
        value = math.sqrt(float(np.mean(kept**2)) / (_KEPT_MOMENT * math.comb(2 * order, order)))
        lowest = value if value < _CLEARLY_LOWER * lowest else lowest
    return lowest if math.isfinite(lowest) else 0.0

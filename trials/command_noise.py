"""Measurement noise of a recorded command: detection and removal, so that it causes no reversals.

A play follows the extremes of its input: it turns the noise of a measured command, such as a pressure, into false
travel, and at rest the model drifts with the logarithm of time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .segments import turning_points
from .trial import Trial
from .types import Vec

_LEAST, _MOST = 2e-4, 0.08  # of the command's range: smaller noise has no effect, larger noise is a random command
_LONGEST_S = 0.12  # noise with a longer correlation time is a motion
_BLOCK, _QUIET = 16, 0.3  # samples of a block, and the share of the evaluated blocks: the least motion
_LEAST_BLOCKS, _OF_QUIET = 8, 1.5  # noise over its level in the quietest blocks
_NORMAL = 1.4826  # standard deviation over the median distance
# Times as far apart, and by what factor white noise may seem larger then; a walk would be larger by 1.4 and 2.
_FARTHER = ((2, 1.3), (4, 1.5))
_LONE = 4.0  # standard deviations: larger residuals are steps or corners
_FLAT = 2.5  # greatest ratio between the two parts of the upper half of a white spectrum
_ROUNDED = 0.5  # of the least change: rounding has 0.29
_LAGS = 8  # greatest delay of the angle's response [samples]
_BY_CHANCE, _ANSWER = 4.0, 0.02  # multiple of chance; least response, relative to the device's slope
_WINDOWS = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
_AGREE = 1.5  # standard deviations; more rounds corners, less leaves noise
_ALIKE = 1.6  # greatest ratio between the noise estimates of two trials
_TURN = 2.5  # standard deviations of the noise: smaller reversals are ignored


def remove_command_noise(trials: Sequence[Trial]) -> list[Trial]:
    """Remove the measurement noise of the command from trials of one device; its size is stored in `command_noise`.

    Trials without noise remain unchanged. If one trial has noise, it is also removed from others with equally noisy
    quiet parts.
    """
    noises = [(0.0, 1) if trial.command_noise > 0 else _noise_level(trial) for trial in trials]
    sure = [noise for noise in noises if noise[0] > 0]
    if not sure:
        return list(trials)
    usual = sorted(sure)[len(sure) // 2]
    return [
        _without(trial, *(noise if noise[0] > 0 else _like(trial, *usual)))
        for trial, noise in zip(trials, noises, strict=True)
    ]


def noise_text(trial: Trial) -> str:
    """Text on the noise removed from the command of a trial; empty if there was none."""
    if trial.command_noise == 0:
        return ""
    return f"noise of {trial.command_noise:.2g} {trial.units.command} is taken off the measured command"


def _without(trial: Trial, sigma: float, stride: int) -> Trial:
    if sigma == 0:
        return trial
    return replace(
        trial, command=_monotone(_smoothed(trial.command, sigma, stride), _TURN * sigma), command_noise=sigma
    )


def _like(trial: Trial, sigma: float, stride: int) -> tuple[float, int]:
    """Noise level of the other trials, if the quietest parts of this trial are as noisy; otherwise zero."""
    thinned = trial.command[::stride]
    if trial.command_noise > 0 or thinned.size < _LEAST_BLOCKS * _BLOCK:
        return 0.0, 1
    level = _quietest(_residuals(trial.t[::stride], thinned[:, None])[:, 0])[0]
    return (level, stride) if sigma / _ALIKE < level < _ALIKE * sigma else (0.0, 1)


def _noise_level(trial: Trial) -> tuple[float, int]:
    """Standard deviation of the command noise, 0 for none, and its correlation length in samples.

    Noise is the residual of a cubic through the neighbouring samples in the half of the log with less motion. It must
    be always present, white (equal at larger sample distances, with a flat spectrum), no rounding, and without response
    of the angle. Commands in steps or lines are not always noisy, smooth commands are not white, and random commands
    are large or have a response.
    """
    stride, signals = 1, np.column_stack([trial.command, trial.angle])
    while stride == 1 or stride * trial.dt <= _LONGEST_S:
        sigma = _white(trial.t[::stride], signals[::stride])
        if sigma > 0:
            return sigma, stride
        stride *= 2
    return 0.0, 1


def _white(t: Vec, signals: Vec) -> float:
    """Standard deviation of white noise in the command without response of the output; 0 if there is none."""
    span, height = (float(v) for v in np.ptp(signals, axis=0))
    if t.size < _LEAST_BLOCKS * _BLOCK or not span > 0:
        return 0.0
    left = _residuals(t, signals)
    sigma, rests = _quietest(left[:, 0])
    changes = np.abs(np.diff(signals[:, 0]))
    least = max(_LEAST * span, _ROUNDED * float(np.min(changes[changes > 0])))
    if not least <= sigma <= _MOST * span:
        return 0.0
    for farther, factor in _FARTHER:
        apart = _residuals(t[::farther], signals[::farther, :1])[:, 0]
        at = np.arange(apart.size) * farther
        if not sigma / factor <= _deviation(apart[rests[np.minimum(at, rests.size - 1)]]) <= sigma * factor:
            return 0.0
    blocks = left[: left.shape[0] // _BLOCK * _BLOCK, 0].reshape(-1, _BLOCK)
    if not _is_flat(blocks[rests[: blocks.size : _BLOCK]]):
        return 0.0
    return 0.0 if _responds(left, rests, sigma, height / span) else sigma


def _deviation(left: Vec) -> float:
    return _NORMAL * float(np.median(np.abs(left)))


def _quietest(left: Vec) -> tuple[float, NDArray[np.bool_]]:
    """Robust standard deviation of the quietest blocks of residuals (T,), and the mask of their samples (T,)."""
    blocks = left[: left.size // _BLOCK * _BLOCK].reshape(-1, _BLOCK)
    levels = np.median(np.abs(blocks), axis=1)
    rests = np.zeros(left.size, dtype=bool)
    for block in np.argsort(levels, kind="stable")[: max(round(_QUIET * levels.size), _LEAST_BLOCKS)]:
        rests[block * _BLOCK : (block + 1) * _BLOCK] = True
    return _OF_QUIET * _deviation(left[rests]), rests


def _residuals(t: Vec, signals: Vec) -> Vec:
    """Residuals (T - 4, K) from the cubic through two neighbours on each side, with the variance of white noise."""
    at = [np.arange(k, t.size - 4 + k) for k in (0, 1, 3, 4)]
    middle, power = np.arange(2, t.size - 2), np.ones(t.size - 4)
    left = signals[middle].copy()
    for node in at:
        weight = np.ones(middle.size)
        for other in at:
            if other is not node:
                weight *= (t[middle] - t[other]) / (t[node] - t[other])
        left -= weight[:, None] * signals[node]
        power += weight**2
    return np.asarray(left / np.sqrt(power)[:, None])


def _is_flat(blocks: Vec) -> bool:
    """Whether blocks of residuals (B, N) come from a signal with a white spectrum in the upper half of its band."""
    power = np.mean(np.abs(np.fft.rfft(blocks * np.hanning(blocks.shape[1]), axis=1)) ** 2, axis=0)
    turns = np.pi * np.linspace(0, 1, power.size)
    upper = slice(power.size // 2, None)
    white = (power / (2 * np.sin(turns / 2) + 1e-9) ** 8)[upper]
    parts = [float(part.mean()) for part in np.array_split(white, 2)]
    return max(parts) < _FLAT * min(parts)


def _responds(left: Vec, rests: NDArray[np.bool_], sigma: float, slope: float) -> bool:
    """Whether the output responds to the fast part of the command, by regression on residuals (T, 2) at rest (T,)."""
    ends = np.flatnonzero(rests)
    ends = ends[ends >= _LAGS]
    past = np.column_stack([left[ends - lag, 0] for lag in range(_LAGS + 1)])
    still = np.all(np.abs(past) < _LONE * sigma, axis=1)
    past, angle = past[still], left[ends[still], 1]
    if past.shape[0] < _BLOCK:
        return True
    answer = past @ np.linalg.lstsq(past, angle, rcond=None)[0]
    explained = float(answer @ answer) / max(float(angle @ angle), 1e-300)
    size = math.sqrt(float(answer @ answer) / max(float(past[:, 0] @ past[:, 0]), 1e-300))
    return explained > _BY_CHANCE * past.shape[1] / past.shape[0] and size > _ANSWER * slope


def _smoothed(command: Vec, sigma: float, stride: int) -> Vec:
    """Smooth the command by local straight lines over adaptive windows before and after each sample.

    Each side uses its longest window whose value agrees with those of all shorter ones: steps and corners stay in
    place, and a rest is averaged over hundreds of samples.

    Source: Katkovnik, A new method for varying adaptive bandwidth selection, IEEE Trans. Signal Process. 47 (1999)
    2567-2571 (intersection of confidence intervals).
    """
    before, sizes = _one_sided(command, sigma, stride)
    after, others = (part[::-1] for part in _one_sided(command[::-1], sigma, stride))
    return np.asarray((before / sizes + after / others) / (1 / sizes + 1 / others))


def _one_sided(command: Vec, sigma: float, stride: int) -> tuple[Vec, Vec]:
    """One-sided local linear estimates (T,) from past samples, and their variances."""
    value, variance = command.copy(), np.full(command.size, sigma**2)
    low, high, open_ = command - _AGREE * sigma, command + _AGREE * sigma, np.ones(command.size, dtype=bool)
    sums = [np.concatenate([[0.0], np.cumsum(np.arange(command.size) ** k * (command - command[0]))]) for k in (0, 1)]
    for size in (stride * window for window in _WINDOWS):
        if size > command.size:
            break
        end = np.arange(size, command.size + 1)
        total, moment = (s[end] - s[end - size] for s in sums)
        mean = total / size
        tilt = (moment - (end - 0.5 * (size + 1)) * total) * 12 / (size * (size**2 - 1.0))
        ends = command[0] + mean + tilt * 0.5 * (size - 1)
        spread = sigma**2 * min(1.0, (4.0 * size - 2.0) / (size * (size + 1.0)) * stride)
        at = end - 1
        low[at] = np.maximum(low[at], ends - _AGREE * math.sqrt(spread))
        high[at] = np.minimum(high[at], ends + _AGREE * math.sqrt(spread))
        open_[: size - 1] = False
        open_[at] &= low[at] <= high[at]
        kept = at[open_[at]]
        value[kept], variance[kept] = ends[open_[at]], spread
    return value, variance


def _monotone(command: Vec, turn: float) -> Vec:
    """Monotone least-squares fit of the command between reversals of at least size `turn`."""
    from scipy.optimize import isotonic_regression  # half a second to import

    made, turns = command.copy(), turning_points(command, turn)[1].tolist()
    for a, b in itertools.pairwise(dict.fromkeys([0, *turns, command.size - 1])):
        rising = bool(command[b] >= command[a])
        made[a : b + 1] = isotonic_regression(command[a : b + 1], increasing=rising).x
    return made

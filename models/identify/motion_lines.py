"""Spectral lines of errors and motions: a disturbance at a line of the motion cannot be distinguished from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.trials.types import Mask, Vec

from .runs import Run

_LEAKS = 2.0  # least power of a separate line, in multiples of the leakage
_PURE = 0.5  # share of the command's energy in one line for a fundamental frequency
_LOW_ORDERS = 5  # harmonics of a loop with enough energy to leak over a trial's resolution
_ROUNDING = 0.01  # error of the fundamental, as share of a trial's resolution
_PERIODS = 3.0  # least periods in a run for higher harmonics
_MOST = 0.5  # share of the recorded time in which a line has to be the motion's


def fundamental_hz(command: Vec, dt_s: float) -> float:
    """Frequency of a motion with most of its energy in one line [Hz]; 0 of other motions."""
    from scipy.signal import get_window  # half a second to import

    hz = np.fft.rfftfreq(command.size, dt_s)
    power = np.abs(np.fft.rfft(get_window("hann", command.size) * (command - command.mean()))) ** 2
    power[0] = 0.0
    top = int(np.argmax(power))
    near = slice(max(top - 2, 0), top + 3)
    if power[near].sum() < _PURE * power.sum() or power[near].sum() <= 0:
        return 0.0
    return float(power[near] @ hz[near] / power[near].sum())


def motion_frequencies(runs: Sequence[Run], hz: Vec) -> Mask:
    """Mask of the frequencies (F,) that are lines of the motion in at least half of the recorded time.

    These are nearer to its fundamental or a harmonic than 1 / T, with T the time of all runs together. For the first
    five harmonics, whose size varies with the width of the loop, the limit is one over the duration of each run, since
    each run has a separate phase. A run of fewer than three periods has only these five, with the limit 1 / T.
    """
    seconds = np.array([run.command.size * run.dt_s for run in runs])
    seconds_at = np.zeros(hz.size)
    for run, length in zip(runs, seconds, strict=True):
        fundamental = fundamental_hz(run.command, run.dt_s)
        if fundamental <= 0:
            continue
        order = np.maximum(np.rint(hz / fundamental), 1.0)
        together = 1.0 / seconds.sum()
        low, high = 1.0 / length, together + _ROUNDING * order / length
        if fundamental * length < _PERIODS:
            low, high = together, np.zeros(hz.size)
        nearest = np.where(order <= _LOW_ORDERS, low, high)
        seconds_at += length * (np.abs(hz - order * fundamental) <= nearest)
    return np.asarray(seconds_at >= _MOST * seconds.sum())


def leaked_power(power: Vec, hz: Vec, of_motion: Mask, seconds: Vec) -> Vec:
    """Power (F,) that runs of finite length leak from the lines of the motion to other frequencies.

    Of each band of the motion the highest line counts. A wave of power P that lasts T seconds has at most P / (pi d
    T)^2 at a distance d from its frequency, and P nearer than 1 / (pi T) (Harris, On the use of windows, Proc. IEEE 66,
    1978: rectangular window).

    Args:
        power: of each run (R, F).
        hz: frequencies (F,) [Hz].
        of_motion: mask of the motion's frequencies (F,).
        seconds: duration of each run (R,) [s].
    """
    leaked, whole = np.zeros(hz.size), power.sum(axis=0)
    edges = np.flatnonzero(np.diff(of_motion, prepend=False, append=False))
    for first, stop in edges.reshape(-1, 2):
        k = first + int(np.argmax(whole[first:stop]))
        if whole[max(k - 1, 0) : k + 2].max() > whole[k]:
            continue  # the flank of a line outside
        for height, length in zip(power[:, k], seconds, strict=True):
            leaked += height / np.maximum(1.0, (np.pi * (hz - hz[k]) * length) ** 2)
    return leaked


def strongest_line(runs: list[Run], errors: list[Vec], lowest_hz: float, highest_hz: float) -> float:
    """Frequency of the wave, with a separate phase in each trial, that explains most of the errors [Hz]; 0 for none.

    Lines of the motions (`motion_frequencies`) and lines no larger than their leakage (`leaked_power`) are left out.
    The grid is as fine as the longest trial resolves, then refined by a parabola. Powers are computed by a chirp
    z-transform: a table of all waves at all samples would take gigabytes at ten minutes.
    """
    from scipy.signal import zoom_fft  # half a second to import

    longest = max(error.size * run.dt_s for run, error in zip(runs, errors, strict=True))
    step_hz = 0.25 / longest
    grid = np.arange(step_hz, highest_hz, step_hz)  # from below `lowest_hz`, where a motion may leak from
    power = np.empty((len(runs), grid.size))
    stop_hz = (grid.size + 1) * step_hz
    for row, run, error in zip(power, runs, errors, strict=True):
        signal = np.zeros(run.counts.size)
        signal[run.counts] = error - error.mean()
        waves = zoom_fft(signal, [step_hz * run.dt_s, stop_hz * run.dt_s], grid.size, fs=1)
        row[:] = np.abs(waves) ** 2 / error.size
    seconds = np.array([error.size * run.dt_s for run, error in zip(runs, errors, strict=True)])
    hidden = motion_frequencies(runs, grid)
    hidden |= power.sum(axis=0) < _LEAKS * leaked_power(power, grid, hidden, seconds)
    power = np.where(hidden | (grid < lowest_hz), 0.0, power.sum(axis=0))
    k = int(np.argmax(power))
    if power[k] <= 0:
        return 0.0
    if 0 < k < grid.size - 1:
        left, middle, right = power[k - 1 : k + 2]
        curve = left - 2 * middle + right
        refined = grid[k] + 0.5 * (left - right) / curve * (grid[1] - grid[0]) if curve else grid[k]
        return float(grid[k] if motion_frequencies(runs, np.array([refined]))[0] else refined)
    return float(grid[k])

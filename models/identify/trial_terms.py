"""What a trial has of its own: a shift against the others, a disturbance's phase. Linear, so it is projected out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.signal import zoom_fft

from hystmpc.trials.types import Vec

from .runs import Run

_BLOCK_S = 4.0
_RIDGE = 1e-9


@final
@dataclass(frozen=True)
class TrialTerms:
    """Linear terms with coefficients of each trial.

    Attributes:
        shift: offset, gain and width of the trial, to first order: columns 1, theta and d theta / d width.
        frequency_hz: of a disturbance whose phase each trial has for itself; 0 for none.
        harmonics: of that disturbance.
        width: position of the baseline's width among the unknowns, -1 for none.
    """

    shift: bool = False
    frequency_hz: float = 0.0
    harmonics: int = 2
    width: int = -1

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that these terms stand for."""
        return (*(("trial_shift",) if self.shift else ()), *(("periodic_disturbance",) if self.frequency_hz else ()))

    def columns(self, run: Run, theta: Vec, by_q: Vec) -> Vec:
        """The terms (C, K) at the samples that count."""
        made: list[Vec] = []
        if self.shift:
            made += [np.ones(theta.size), theta - theta.mean()]
            if self.width >= 0 and np.ptp(by_q[:, self.width]) > 0:
                made.append(by_q[:, self.width])
        if self.frequency_hz:
            turns = 2 * np.pi * self.frequency_hz * run.dt_s * np.flatnonzero(run.counts)
            made += [wave(h * turns) for h in range(1, self.harmonics + 1) for wave in (np.sin, np.cos)]
        return np.stack(made, axis=1) if made else np.empty((theta.size, 0))

    def amplitude(self, run: Run, theta: Vec, by_q: Vec) -> float:
        """Amplitude of the first harmonic of the disturbance in a run [deg]."""
        weights = self._weights(run, theta, by_q)
        first = weights[-2 * self.harmonics :][:2]
        return float(np.hypot(first[0], first[1]))

    def offset(self, run: Run, theta: Vec, by_q: Vec) -> float:
        """Mean of the shift of a run [deg]."""
        return float(-self._weights(run, theta, by_q)[0])

    def _weights(self, run: Run, theta: Vec, by_q: Vec) -> Vec:
        """Coefficients (K,) of the terms that explain most of a run's error."""
        columns = self.columns(run, theta[run.counts], by_q[run.counts])
        return np.asarray(np.linalg.lstsq(columns, (theta - run.angle)[run.counts], rcond=None)[0], dtype=np.float64)

    def common(self, run: Run, theta: Vec, error: Vec, by_q: Vec) -> tuple[Vec, Vec]:
        """Offset and gain of a run against the others (2,) [deg], and their derivative (2, Q); none without a shift.

        The gain counts by what it moves: the coefficient of theta times the spread of theta.
        """
        if not self.shift:
            return np.empty(0), np.empty((0, by_q.shape[1]))
        columns = self.columns(run, theta, by_q)
        scale = np.array([1.0, max(float(theta.std()), 1e-9)])[:, None]
        found = scale * np.linalg.pinv(columns)[:2]
        return found @ error, found @ by_q

    def projected(self, run: Run, theta: Vec, error: Vec, by_q: Vec) -> tuple[Vec, Vec]:
        """Error (C,) and derivative (C, Q) less what the terms explain of them."""
        columns = self.columns(run, theta, by_q)
        if not columns.shape[1]:
            return error, by_q
        basis = np.linalg.qr(columns)[0]
        return error - basis @ (basis.T @ error), by_q - basis @ (basis.T @ by_q)

    def cross_fitted(self, run: Run, theta: Vec, error: Vec, by_q: Vec) -> Vec:
        """Error (C,) less the terms, whose coefficients come from every other block of four seconds."""
        columns = self.columns(run, theta, by_q)
        if not columns.shape[1]:
            return error
        odd = run.blocks(_BLOCK_S) % 2 == 1
        left = error.copy()
        for chosen in (odd, ~odd):
            seen = ~chosen if (~chosen).any() else chosen
            square = columns[seen].T @ columns[seen]
            square += _RIDGE * np.trace(square) * np.eye(square.shape[0])
            left[chosen] -= columns[chosen] @ np.linalg.solve(square, columns[seen].T @ error[seen])
        return left


NO_TERMS = TrialTerms()


def strongest_line(runs: list[Run], errors: list[Vec], lowest_hz: float, highest_hz: float) -> float:
    """Frequency at which waves with a phase of each trial explain most of the errors [Hz].

    The grid is as fine as the longest trial resolves, then refined by a parabola. Its powers come from a chirp
    z-transform: a table of all waves at all samples grows with the square of the duration, to gigabytes at ten minutes.
    """
    longest = max(error.size * run.dt_s for run, error in zip(runs, errors, strict=True))
    grid = np.arange(lowest_hz, highest_hz, 0.25 / longest)
    power = np.zeros(grid.size)
    stop_hz = lowest_hz + grid.size * 0.25 / longest
    for run, error in zip(runs, errors, strict=True):
        signal = np.zeros(run.counts.size)
        signal[run.counts] = error - error.mean()
        waves = zoom_fft(signal, [lowest_hz * run.dt_s, stop_hz * run.dt_s], grid.size, fs=1)
        power += np.abs(waves) ** 2 / error.size
    k = int(np.argmax(power))
    if 0 < k < grid.size - 1:
        left, middle, right = power[k - 1 : k + 2]
        curve = left - 2 * middle + right
        return float(grid[k] + 0.5 * (left - right) / curve * (grid[1] - grid[0])) if curve else float(grid[k])
    return float(grid[k])

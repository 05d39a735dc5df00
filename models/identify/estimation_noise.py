"""Noise model for an estimator: white noise of the sensor, random walks, and the resolution of the sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..contract.export import ExportBundle
from ..contract.metadata import NoiseModel, slow_error
from ..decades import Decades
from ..evaluate import started
from ..model import LoadedModel

_LEAST_DEG = 1e-4  # least noise of the sensor: smaller residuals are rounding errors of noise-free simulations
_RATIOS = np.linspace(-18.0, 6.0, 7)  # logarithms of the ratio of the walk's variance in a sample to that of the sensor
_GREATEST_OPTIMISM = 2.0
_UNDITHERED = 2.0  # greatest step in standard deviations at which the mean of the readings is right within q / 100
_LONGEST = 4000  # simulated samples of one trial: enough for three parameters


def estimation_noise(trials: Sequence[Trial], residuals: Sequence[Vec], fitted: int = 0) -> NoiseModel:
    """Maximum-likelihood noise model of the residuals of free runs, for the estimator of a controller.

    r_k = d_k + v_k with v white and d a separate random walk for each trial; see `NoiseModel`. Likelihood by the Kalman
    filter, the variance of v eliminated in closed form, the two ratios by Nelder and Mead from the best point of a grid
    (Harvey, "Forecasting, structural time series models and the Kalman filter", 1989, section 3.4).

    Residuals of fitted trials are too small. A least-squares fit of p parameters to n independent errors leaves (n - p)
    / n of their variance; errors whose neighbours are correlated by rho count as n (1 - rho) / (1 + rho) independent
    ones (Bartlett, J. Roy. Stat. Soc. 98, 1935). Drift and motion are enlarged by the square root of that factor, at
    most by 2; the sensor's noise is not.

    Readings of a step q are off by q^2 / 12 in mean square (Widrow, Trans. AIEE 79, 1961), which bounds the sensor's
    variance from below: noise below q does not make that error white.

    The error of the model without a sensor is that of `slow_error`, enlarged likewise.

    Args:
        trials: uniformly sampled at one rate.
        residuals: measurement less model, or the reverse, of the last samples of each trial (C,) [deg].
        fitted: number p of parameters that were fitted to these trials; 0 where they were held out.

    Raises:
        FitError: if there are no residuals, more than samples in a trial, or they are not finite.
    """
    decades = Decades.of(trials)
    output = decades.output(trials)
    return decades.log_noise(_noise(decades.trials(trials), [residual / output for residual in residuals], fitted))


def _noise(trials: Sequence[Trial], residuals: Sequence[Vec], fitted: int) -> NoiseModel:
    travels = []
    for trial, residual in zip(trials, residuals, strict=True):
        if not 2 <= residual.size <= len(trial) or not np.isfinite(residual).all():
            raise FitError(f"{trial.source}: got {residual.size} residuals, expected 2 to {len(trial)} finite ones")
        moves = np.abs(np.diff(trial.command, prepend=trial.command[0]))[-residual.size :]
        travels.append(np.concatenate([[-1.0], moves[1:]]))  # below zero at the start of a trial
    if not travels:
        raise FitError("got no residuals, expected those of at least one trial")
    joint, travel = np.concatenate(residuals), np.concatenate(travels)
    step = resolution([trial.angle for trial in trials])
    usual = max(float(np.mean(travel[travel > 0])) if np.any(travel > 0) else 1.0, 1e-12)
    drift, motion = _most_likely_ratios(joint, travel, usual)
    sensor = math.sqrt(max(walk_likelihood(joint, travel, drift, motion)[1], _LEAST_DEG**2))
    factor = _optimism(residuals, fitted)
    more = factor * sensor
    return NoiseModel(
        sensor_sigma_deg=max(sensor, step / math.sqrt(12.0)),
        drift_sigma_deg_per_sqrt_s=more * math.sqrt(drift / trials[0].dt),
        motion_sigma_deg_per_sqrt_unit=more * math.sqrt(motion),
        model_sigma_deg=factor * _slow_error(residuals),
        sensor_resolution_deg=step if step > _UNDITHERED * sensor else 0.0,
    )


def _slow_error(residuals: Sequence[Vec]) -> float:
    """Error of free runs on other motions [deg], see `slow_error`; a single trial counts as its thirds."""
    parts = residuals if len(residuals) > 1 else [part for part in np.array_split(residuals[0], 3) if part.size > 1]
    parts = parts or residuals
    squares = [float(np.mean(part[1:] * part[:-1])) for part in parts]
    return slow_error(squares, [part.size - 1 for part in parts])


@final
class ReferenceModel(LoadedModel):
    """Model before its export, simulated by the reference of its bundle."""

    def __init__(self, bundle: ExportBundle) -> None:
        super().__init__(bundle.metadata, "initial")
        self._reference = bundle.reference

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        return self._reference.advance(state, u)

    def casadi_function(self) -> Any:
        """Refuse a CasADi function, which only the export makes.

        Raises:
            FitError: always.
        """
        raise FitError("the reference of an export has no CasADi function, expected the exported model")


def with_noise(bundle: ExportBundle, trials: Sequence[Trial], fitted: int) -> ExportBundle:
    """Add the noise model, from free runs of the reference over trials, to a bundle; an inverse map stays unchanged."""
    facts = bundle.metadata
    if facts.inverted:
        return bundle
    heads = [trial.select(0, min(len(trial), _LONGEST)) for trial in trials]
    model = ReferenceModel(bundle)
    starts = [started(model, trial) for trial in heads]
    rows = [np.concatenate([start.approach, trial.command]) for trial, start in zip(heads, starts, strict=True)]
    longest = max(row.size for row in rows)
    states = model.resting(*np.array([(start.command, start.angle) for start in starts]).T)
    runs = model.run_on(states, np.array([np.pad(row, (0, longest - row.size), mode="edge") for row in rows]))[0]
    residuals = [
        (trial.angle - run[len(start.approach) :][: len(trial)])[start.lead :]
        for trial, run, start in zip(heads, runs, starts, strict=True)
    ]
    noise = estimation_noise(heads, residuals, fitted)
    return replace(bundle, metadata=facts.model_copy(update={"noise": noise}))


def _most_likely_ratios(residuals: Vec, travel: Vec, usual: float) -> tuple[float, float]:
    """Variances of the walk in a sample and over one unit of travel, in variances of the sensor."""
    from scipy.optimize import minimize  # half a second to import

    def cost(logs: Vec) -> float:
        drift, motion = np.exp(np.clip(logs, -25.0, 12.0))
        return float(walk_likelihood(residuals, travel, drift, motion / usual)[0])

    corners = [np.array([a, b]) for a in _RATIOS for b in _RATIOS]
    best = min(corners, key=cost)
    log_sizes = minimize(cost, best, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-3, "maxfev": 200}).x
    drift, motion = np.exp(np.clip(log_sizes, -25.0, 12.0)).tolist()
    return drift, motion / usual


def _optimism(residuals: Sequence[Vec], fitted: int) -> float:
    """Factor by which standard deviations on fitted trials are too small."""
    if fitted == 0:
        return 1.0
    around = [residual - residual.mean() for residual in residuals]
    power = sum(float(part @ part) for part in around)
    rho = sum(float(part[1:] @ part[:-1]) for part in around) / power if power > 0 else 0.0
    rho = min(max(rho, 0.0), 0.999)
    independent = sum(part.size for part in around) * (1.0 - rho) / (1.0 + rho)
    return min(math.sqrt(independent / max(independent - fitted, 1e-9)), _GREATEST_OPTIMISM)


def walk_likelihood(residuals: Vec, travel: Vec, drift: float, motion: float) -> tuple[float, float]:
    """Twice the negative log-likelihood without a constant, and the sensor's variance [deg^2].

    P, S in variances of the sensor:  S = P + 1,  r = mean e^2 / S,  cost = n log r + sum log S.

    Args:
        residuals: (T,) [deg].
        travel: of the command in the sample before each (T,) [command unit]; below zero at the first one of a trial.
        drift, motion: variance of the walk in a sample, and over one unit of travel, in variances of the sensor.
    """
    sensor = np.empty(1)
    cost = engine().walk_likelihood(residuals, travel, residuals.size, drift, motion, sensor)
    return cost, float(sensor[0])


_ON_GRID, _GRID_TOLERANCE = 0.95, 0.1  # share of readings; tolerance as share of the step (by chance: a fifth)
_LEAST_LEVELS, _READINGS, _MOST_VALUES = 3, 25, 20_000  # least levels, readings on each; most levels searched
_MANY_LEVELS = 9  # number of levels that are not on a grid by chance
_APART = 0.5  # share of a typical gap between levels; readings with a smaller gap are of one level


def resolution(signals: Sequence[Vec]) -> float:
    """Step of the sensor's readings, in their unit; 0 for a continuous sensor.

    The search uses all readings, then repeated ones, which interpolation leaves on the grid, then clusters, for noise
    added after rounding. The last digit of a log is a grid, too.
    """
    values = np.concatenate(signals)
    repeated = np.concatenate([signal[1:][np.diff(signal) == 0] for signal in signals])
    step = max(grid_step(values), _of_many_levels(repeated, np.unique(repeated)))
    return step or _of_many_levels(values, _clusters(values))


def grid_step(values: Vec) -> float:
    """Largest step of a grid with any offset that contains 95 % of the values; 0 without one."""
    return _step(values, np.unique(values))


def _of_many_levels(values: Vec, levels: Vec) -> float:
    """Step of a grid with too many levels for chance, see `grid_step`."""
    return _step(values, levels) if levels.size >= _MANY_LEVELS else 0.0


def _clusters(values: Vec) -> Vec:
    """Means of the groups of values between wide gaps; each value where there are no wide gaps."""
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
    fits = [_grid_fit(levels, guess, values) for guess in guesses]
    return max((step for step, share in fits if share >= _ON_GRID), default=0.0)


def _grid_fit(levels: Vec, guess: float, values: Vec) -> tuple[float, float]:
    """Quantisation step near a guess, by regression on integers, and the share of values on its grid."""
    numbers = np.concatenate([[0.0], np.cumsum(np.rint(np.diff(levels) / guess))])
    if numbers[-1] + 1 < min(_MANY_LEVELS, levels.size):
        return 0.0, 0.0
    step = float(np.polyfit(numbers, levels, 1)[0])
    if step <= 0:
        return 0.0, 0.0
    turn = np.exp(2j * np.pi * values / step)
    off = np.angle(turn * np.conj(np.mean(turn))) / (2 * np.pi)
    return step, float(np.mean(np.abs(off) <= _GRID_TOLERANCE))

"""How noisy the sensor is and how far the model is off: a bank of Kalman filters that judges it while the loop runs."""

from __future__ import annotations

import math
from typing import Any, final

import numpy as np

from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.kernels.numba_ import njit
from hystmpc.models.model import Predictor
from hystmpc.trials.types import Vec

# Without facts: a good sensor, and a model that is right within some tenths of a degree.
_UNKNOWN = NoiseModel(sensor_sigma_deg=0.1, drift_sigma_deg_per_sqrt_s=0.2, motion_sigma_deg_per_sqrt_unit=0.4)
_SENSOR_FACTORS = 2.0 ** np.arange(-3.5, 3.6, 0.5)
_DRIFT = 0.01 * 3.0 ** np.arange(6)  # deg/sqrt(s): from a model that is exact to one that is lost
_MOTION = np.array([0.1, 0.4, 1.6, 6.4])  # deg over the square root of the whole range of commands
_PRIOR_SPREAD = np.log(4.0)  # of each sigma about what the model file says
_SWITCHING_S = 20.0  # mean time for which one hypothesis holds
import os, json
_o = json.loads(os.environ.get("NB", "{}"))
_SENSOR_S = _o.get("sens_s", 1.0)
_MOST_GAIN = _o.get("most", 0.6)
_SWITCHING_S = _o.get("sw", 20.0)
_UNKNOWN = NoiseModel(sensor_sigma_deg=0.1, drift_sigma_deg_per_sqrt_s=_o.get("drift", 0.2), motion_sigma_deg_per_sqrt_unit=_o.get("motion", 0.4))
_FREEDOM = 7.0  # of Student's distribution: (7 + 1) / 2 is a whole power
_TINY = 1e-20  # deg^2: a sigma of zero has no logarithm
_FIRST = 100.0  # variance of the first disturbance, in those of the sensor: the first measurement decides


Sigmas = tuple[float | None, float | None, float | None]
"""Sensor, drift and motion as in `NoiseModel`; None for one that is to be found."""


@final
class NoiseBank:
    """Kalman filters of one disturbance, each for other noises, weighted by how well they foretell the measurements.

        z_k = y_k - model_k = d_k + v_k,   var(v) = sensor^2,   var(d_k+1 - d_k) = drift^2 dt + motion^2 |du_k|

    Filter i holds one triple of sigmas, and its disturbance d_i and variance P_i are those of the Kalman filter:

        S_i = P_i + sensor_i^2,   e_i = z - d_i,   d_i <- d_i + (P_i / S_i) e_i,   P_i <- P_i sensor_i^2 / S_i
        w_i <- (1 - eps) w_i p(e_i; S_i) / sum_j w_j p(e_j; S_j) + eps w_i0,   eps = dt / 20 s
        d = sum_i w_i d_i,   P = sum_i w_i (P_i + (d_i - d)^2)

    The weights are the probabilities of the hypotheses (Magill, "Optimal adaptive estimation of sampled stochastic
    processes", IEEE TAC 10, 1965). Which one is true may change: with probability eps it is drawn anew in a sample, from
    the probabilities w_i0 at the start (the jump Markov model of Blom and Bar-Shalom, IEEE TAC 33, 1988, whose filters
    are not mixed here). So no weight falls below eps w_i0, and seconds of evidence suffice to change one's mind. p is
    Student's density with 7 degrees of freedom and variance S_i: a single spike says little.

    The grid is fixed, hence every sigma is within its ends for ever, and each filter is a stable one. A sigma that is
    given has no other value; where all three are, this is the Kalman filter.

    Args:
        given: sigmas set by hand.
        predictor: of the model, with what its file says about these sigmas.
        limit_deg: bound of the disturbance [deg].
    """

    def __init__(self, given: Sigmas, predictor: Predictor, limit_deg: float) -> None:
        low, high = predictor.command_range
        known, dt_s = predictor.noise or _UNKNOWN, predictor.dt
        centre = known.sensor_sigma_deg
        sensor, by_sensor = _axis(given[0], centre, centre * _SENSOR_FACTORS)
        drift, by_drift = _axis(given[1], known.drift_sigma_deg_per_sqrt_s, _DRIFT)
        grid = _MOTION / math.sqrt(high - low)
        motion, by_motion = _axis(given[2], known.motion_sigma_deg_per_sqrt_unit, grid)
        squares = np.array([axis.ravel() for axis in np.meshgrid(sensor**2, drift**2, motion**2, indexing="ij")])
        self._dt = dt_s
        self._sensor, self._drift, self._motion = squares[0], dt_s * squares[1], squares[2]
        self._logs = np.log(np.maximum(squares, _TINY))
        self._by_sensor, self._prior = by_sensor, np.outer(by_drift, by_motion).ravel()
        self._start = np.outer(by_sensor, self._prior).ravel()
        self._rates = np.array([dt_s / (dt_s + _SWITCHING_S), dt_s / (dt_s + _SENSOR_S)])
        self._most = _MOST_GAIN if self._start.size > 1 else 1.0
        self._first = _FIRST * (given[0] or known.sensor_sigma_deg) ** 2
        self._limit = limit_deg

    def init(self, disturbance: float) -> tuple[Vec, float]:
        """Rows disturbance, variance, weight (3, M) of a bank whose disturbance [deg] is a guess; its variance."""
        count = self._start.size
        bank = np.array([np.full(count, disturbance), np.full(count, self._first), self._start])
        return bank, self._first

    def correct(self, bank: Vec, offset: float) -> tuple[Vec, float, float]:
        """The bank with a measurement `offset` = y - model [deg] used, its disturbance [deg] and variance [deg^2]."""
        after = np.empty_like(bank)
        mean, variance = corrected(
            bank, self._sensor, self._prior, self._by_sensor, offset, self._rates, self._most, self._limit, after
        )
        return after, mean, variance

    def advance(self, bank: Vec, travel: float, mean: float) -> tuple[Vec, float]:
        """The bank one sample later, and its variance [deg^2].

        Args:
            travel: of the command in that sample [command unit].
            mean: disturbance of the bank [deg].
        """
        after = np.empty_like(bank)
        return after, advanced(bank, self._drift, self._motion, travel, self._limit, mean, after)

    def found(self, bank: Vec) -> NoiseModel:
        """The sigmas as the bank sees them: geometric means over the hypotheses."""
        sensor, drift, motion = np.exp(0.5 * (self._logs @ bank[2])).tolist()
        return NoiseModel(
            sensor_sigma_deg=sensor, drift_sigma_deg_per_sqrt_s=drift, motion_sigma_deg_per_sqrt_unit=motion
        )

    def growth(self, bank: Vec, travel: float) -> float:
        """Variance that the disturbance gains in a sample in which the command travels so far [deg^2], as seen."""
        _, drift, motion = np.exp(self._logs @ bank[2]).tolist()
        return float(drift * self._dt + motion * travel)

    def sensor_variance(self, bank: Vec) -> float:
        """Variance of the sensor's noise [deg^2], as seen."""
        return math.exp(float(self._logs[0] @ bank[2]))


def _axis(given: float | None, centre: float, grid: Vec) -> tuple[Vec, Vec]:
    """Values and probabilities of one sigma."""
    if given is not None:
        return np.array([given]), np.ones(1)
    inside = min(max(centre, grid[0]), grid[-1])
    weights = np.exp(-0.5 * (np.log(grid / inside) / _PRIOR_SPREAD) ** 2)
    return grid, weights / weights.sum()


@njit(cache=True, error_model="numpy", nogil=True)
def corrected(
    bank: Any, sensor: Any, prior: Any, by_sensor: Any, offset: float, rates: Any, most: float, limit: float, after: Any
) -> tuple[float, float]:
    """Write the bank (3, M) after a measurement; answers disturbance [deg] and variance [deg^2]."""
    total = 0.0
    for i in range(sensor.size):
        before, noise = bank[1, i], sensor[i]
        spread, error = before + noise, offset - bank[0, i]
        odd = 1.0 + error * error / ((_FREEDOM - 2.0) * spread)
        odd *= odd
        gain = min(before / spread, most)
        after[0, i] = min(max(bank[0, i] + gain * error, -limit), limit)
        after[1, i] = (1.0 - gain) * (1.0 - gain) * before + gain * gain * noise
        after[2, i] = bank[2, i] / (math.sqrt(spread) * odd * odd)
        total += after[2, i]
    inner, mean = prior.size, 0.0
    for j in range(by_sensor.size):
        share = 0.0
        for i in range(j * inner, (j + 1) * inner):
            share += after[2, i]
        share = rates[0] * ((1.0 - rates[1]) * share / total + rates[1] * by_sensor[j])
        for i in range(inner):
            k = j * inner + i
            after[2, k] = (1.0 - rates[0]) * after[2, k] / total + share * prior[i]
            mean += after[2, k] * after[0, k]
    return mean, mixed_variance(after, mean)


@njit(cache=True, error_model="numpy", nogil=True)
def advanced(bank: Any, drift: Any, motion: Any, travel: float, limit: float, mean: float, after: Any) -> float:
    """Write the bank (3, M) one sample later; answers its variance [deg^2]."""
    for i in range(bank.shape[1]):
        after[0, i] = bank[0, i]
        after[1, i] = min(bank[1, i] + drift[i] + motion[i] * travel, limit * limit)
        after[2, i] = bank[2, i]
    return float(mixed_variance(after, mean))


@njit(cache=True, error_model="numpy", nogil=True)
def mixed_variance(bank: Any, mean: float) -> float:
    """Variance [deg^2] of the mixture about its mean [deg]."""
    total = 0.0
    for i in range(bank.shape[1]):
        total += bank[2, i] * (bank[1, i] + (bank[0, i] - mean) ** 2)
    return total

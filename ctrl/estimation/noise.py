"""Adaptive estimation of sensor noise and model error by a bank of Kalman filters, while the loop runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, final

import numpy as np

from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.kernels.numba_ import njit
from hystmpc.models.model import Predictor
from hystmpc.trials.types import Vec

# Without facts a model is assumed to be good: a few samples show the contrary, it takes hundreds to confirm it.
_UNKNOWN = NoiseModel(sensor_sigma_deg=0.1, drift_sigma_deg_per_sqrt_s=0.1, motion_sigma_deg_per_sqrt_unit=0.2)
_PRIOR_SPREAD = math.log(4.0)  # standard deviation of the logarithm of each sigma about its prior value
_LEAST_SENSOR_DEG = 0.02  # a model of simulated trials without noise gives no information on a real sensor
_SENSOR_FACTORS: Vec = 2.0 ** np.arange(-3.0, 3.1, 0.5)  # factors on the prior value
_DRIFT: Vec = 0.001 * 3.0 ** np.arange(8, dtype=np.float64)  # deg/sqrt(s), up to 2.2
_MOTION: Vec = 0.0016 * 4.0 ** np.arange(7, dtype=np.float64)  # deg over the root of the range of commands
_CLOSE = 0.95  # probability that a model is as close as its file says
_HELD = 0.5  # of that distance: what a disturbance may be uncertain by, since the error of a model changes all the time
_LEAST_MODEL_DEG = 0.01
_SWITCHING_S = 20.0  # mean time between changes of the model's error
_SENSOR_SHARE = 0.2  # of these changes are changes of the sensor too
_MOST_GAIN = 0.5
_FREEDOM = 7.0  # of Student's density: (7 + 1) / 2 is a whole power
_BY_FREEDOM = 1.0 / (_FREEDOM - 2.0)
_FIRST = 100.0  # variance of the first disturbance in those of the sensor: the first measurements decide
_TINY = 1e-20  # deg^2: a sigma of zero has no logarithm

Sigmas = tuple[float | None, float | None, float | None]
"""Sensor, drift and motion as in `NoiseModel`; None for one that is to be found."""


@final
class NoiseBank:
    """Bank of Kalman filters of one disturbance for different noise levels, weighted by their likelihoods.

        z_k = y_k - model_k = d_k + v_k,   var(v) = sensor^2,   var(d_{k+1} - d_k) = drift^2 dt + motion^2 |du_k|

    Filter i holds one triple of sigmas on a fixed grid. Its disturbance d_i has the variance P_i:

        S_i = P_i + sensor_i^2,   K_i = min(P_i / S_i, 1/2),   d_i <- d_i + K_i (z - d_i)
        P_i <- (1 - K_i)^2 P_i + K_i^2 sensor_i^2,   w_i <- w_i p(z - d_i; S_i) / sum_j w_j p(z - d_j; S_j)
        d = sum_i w_i d_i,   P = sum_i w_i (P_i + (d_i - d)^2)

    The weights are the probabilities of the triples (Magill, "Optimal adaptive estimation of sampled stochastic
    processes", IEEE Transactions on Automatic Control 10, 1965). p is Student's density with 7 degrees of freedom and
    variance S_i, so that one outlier has little effect. The model's error may change: in each sample, with probability
    dt / 20 s, drift and motion are drawn anew from their prior, one time in five the sensor too (a jump Markov model,
    Blom and Bar-Shalom, IEEE Transactions on Automatic Control 33, 1988, without their mixing of the filters). No
    weight vanishes, and a wrong model is detected within a second of motion.

    The gain of a bank is bounded because the loop is closed. A plan takes the disturbance for constant, but where the
    model's error answers to the command, as behind a lag that the model lacks, the next command changes it. A gain
    near one then makes an oscillation, which in turn looks like a large drift. K is the filter of internal model
    control, whose robust stability asks for |filter| |relative model error| < 1 at every frequency (Morari and
    Zafiriou, "Robust process control", 1989, section 2.6).

    All sigmas stay on the grid, and every filter is stable. A given sigma is fixed. Where all three are given this is
    the Kalman filter itself, without a bound of its gain.

    Args:
        predictor: of the model, with what its file says about these sigmas.
        limit_deg: bound of the disturbance [deg].
        model_sigma_deg: usual error of the model [deg], for few and noisy measurements. The model is then assumed to be
            that accurate at first, with a probability of 0.95: the filters of the least drift and motion hold half of
            it for the standard deviation of their disturbance, and the disturbance starts at zero.
    """

    def __init__(
        self, given: Sigmas, predictor: Predictor, limit_deg: float, model_sigma_deg: float | None = None
    ) -> None:
        low, high = predictor.command_range
        known = predictor.noise or _UNKNOWN
        usual = max(known.sensor_sigma_deg, _LEAST_SENSOR_DEG)
        least = known.sensor_resolution_deg / math.sqrt(
            12.0
        )  # error of rounding: equal readings are no better than that
        sensor, by_sensor = _axis(given[0], usual, np.maximum(usual * _SENSOR_FACTORS, least))
        drift, by_drift = _axis(given[1], known.drift_sigma_deg_per_sqrt_s, _DRIFT)
        motion, by_motion = _axis(given[2], known.motion_sigma_deg_per_sqrt_unit, _MOTION / math.sqrt(high - low))
        grid = np.array([axis.ravel() for axis in np.meshgrid(sensor, drift, motion, indexing="ij")])
        self._dt, self._limit, self._counts = predictor.dt, limit_deg, (sensor.size, drift.size, motion.size)
        self._sensor, self._drift, self._motion = grid[0] ** 2, predictor.dt * grid[1] ** 2, grid[2] ** 2
        self._logs = np.log(np.maximum(grid**2, _TINY))
        self._by_sensor, self._by_model = by_sensor, np.outer(by_drift, by_motion).ravel()
        if model_sigma_deg is not None:
            self._by_model = (1.0 - _CLOSE) * self._by_model
            self._by_model[0] += _CLOSE
        self._prior = np.outer(self._by_sensor, self._by_model).ravel()
        self._switching = predictor.dt / (predictor.dt + _SWITCHING_S)
        self._most = _MOST_GAIN if self._prior.size > 1 else 1.0
        first, most = np.full(grid.shape[1], _FIRST * (given[0] or usual) ** 2), np.full(grid.shape[1], limit_deg**2)
        if model_sigma_deg is not None:
            close = (grid[1] == drift[0]) & (grid[2] == motion[0])
            first[close] = most[close] = (_HELD * max(model_sigma_deg, _LEAST_MODEL_DEG)) ** 2
        self._first, self._widest = first, most

    def numbers(self) -> Mapping[str, float | Vec]:
        """Return the numbers of the bank, axis by axis of its grid, for code generation."""
        sensors, drifts, motions = self._counts
        return {
            "sensors": sensors,
            "drifts": drifts,
            "motions": motions,
            "filters": self._prior.size,
            "sensor_variances": self._sensor[:: drifts * motions],
            "drift_variances": self._drift[: drifts * motions : motions],
            "motion_variances": self._motion[:motions],
            "by_sensor": self._by_sensor,
            "by_model": self._by_model,
            "first_variance": float(self._first[0]),
            "switching": self._switching,
            "sensor_share": _SENSOR_SHARE,
            "most_gain": self._most,
            "disturbance_limit": self._limit,
        }

    def init(self, disturbance: float) -> tuple[Vec, float]:
        """Return the initial bank (3, M) for a disturbance [deg], rows disturbance, variance, weight; its variance."""
        bank = np.array([np.full(self._prior.size, disturbance), self._first, self._prior])
        return bank, float(self._prior @ self._first)

    def correct(self, bank: Vec, offset: float) -> tuple[Vec, float, float]:
        """Measurement update with `offset` = y - model [deg]: the bank, its disturbance [deg] and variance [deg^2]."""
        after = np.empty_like(bank)
        mean, variance = correct_filters(
            bank, self._sensor, self._by_sensor, self._by_model, offset, self._switching, self._most, self._limit, after
        )
        return after, mean, variance

    def advance(self, bank: Vec, travel: float, disturbance: float) -> tuple[Vec, float]:
        """Time update by one sample with command travel `travel` [command unit]: the bank and its variance [deg^2]."""
        after = np.empty_like(bank)
        variance = advance_filters(bank, self._drift, self._motion, travel, self._widest, disturbance, after)
        return after, float(variance)

    def estimated_noise(self, bank: Vec) -> NoiseModel:
        """Estimated sigmas: geometric means over the filters."""
        sensor, drift, motion = np.sqrt(self._variances(bank)).tolist()
        return NoiseModel(
            sensor_sigma_deg=sensor, drift_sigma_deg_per_sqrt_s=drift, motion_sigma_deg_per_sqrt_unit=motion
        )

    def sensor_variance(self, bank: Vec) -> float:
        """Variance of the sensor noise [deg^2], from `estimated_noise`."""
        return float(self._variances(bank)[0])

    def growth(self, bank: Vec, travel: float) -> float:
        """Growth of the disturbance's variance in a sample with this command travel [deg^2], from `estimated_noise`."""
        _, drift, motion = self._variances(bank).tolist()
        return float(drift * self._dt + motion * travel)

    def ahead(self, bank: Vec, travels: Vec) -> Vec:
        """Growth of the disturbance's variance to the ends of the coming samples without a measurement (H,) [deg^2].

        sum_i w_i (min(P_i + k drift_i^2 dt + motion_i^2 sum_{j<=k} |du_j|, greatest_i) - P_i)
        """
        variance, weight = bank[1], bank[2]
        steps = np.arange(1.0, travels.size + 1.0)
        grown = variance + steps[:, None] * self._drift + np.cumsum(travels)[:, None] * self._motion
        return np.asarray((np.minimum(grown, self._widest) - variance) @ weight)

    def _variances(self, bank: Vec) -> Vec:
        return np.asarray(np.exp(self._logs @ bank[2]))


def _axis(given: float | None, known: float, grid: Vec) -> tuple[Vec, Vec]:
    """Values and prior probabilities of one sigma."""
    if given is not None:
        return np.array([given]), np.ones(1)
    centre = min(max(known, grid[0]), grid[-1])
    weights = np.exp(-0.5 * (np.log(grid / centre) / _PRIOR_SPREAD) ** 2)
    return grid, weights / weights.sum()


@njit(cache=True, error_model="numpy", nogil=True)
def correct_filters(
    bank: Any,
    sensor: Any,
    by_sensor: Any,
    by_model: Any,
    offset: float,
    switching: float,
    most: float,
    limit: float,
    after: Any,
) -> tuple[float, float]:
    """Measurement update of the bank (3, M) into `after`; returns disturbance [deg] and variance [deg^2].

    Args:
        sensor: variance of each filter's sensor (M,) [deg^2].
        by_sensor, by_model: prior of the sensors (J,) and of drift and motion (M / J,), sensor by sensor.
        switching: probability of a change in a sample.
    """
    terms = np.empty(sensor.size)
    for i in range(sensor.size):  # sums have loops of their own: they would keep this one from being vectorised
        before, noise = bank[1, i], sensor[i]
        spread, error = before + noise, offset - bank[0, i]
        by_spread = 1.0 / spread
        odd = 1.0 + error * error * by_spread * _BY_FREEDOM
        odd *= odd
        gain = min(before * by_spread, most)
        after[0, i] = min(max(bank[0, i] + gain * error, -limit), limit)
        after[1, i] = (1.0 - gain) * (1.0 - gain) * before + gain * gain * noise
        after[2, i] = bank[2, i] / (math.sqrt(spread) * odd * odd)
    total = sum_of(after[2])
    inner, kept = by_model.size, (1.0 - switching) / total
    for j in range(by_sensor.size):
        share = sum_of(after[2, j * inner : (j + 1) * inner])
        share = switching * ((1.0 - _SENSOR_SHARE) * share / total + _SENSOR_SHARE * by_sensor[j])
        for i in range(inner):
            k = j * inner + i
            after[2, k] = kept * after[2, k] + share * by_model[i]
            terms[k] = after[2, k] * (after[0, k] - after[0, 0])
    mean = after[0, 0] + sum_of(terms)
    return mean, mixed_variance(after, mean, terms)


@njit(cache=True, error_model="numpy", nogil=True)
def advance_filters(bank: Any, drift: Any, motion: Any, travel: float, widest: Any, mean: float, after: Any) -> float:
    """Time update of the bank (3, M) into `after`; returns its variance about `mean` [deg^2].

    Args:
        drift, motion: variance of each filter's walk in a sample, and over one unit of travel (M,).
        widest: greatest variance of each filter's disturbance (M,) [deg^2].
    """
    for i in range(bank.shape[1]):
        after[0, i] = bank[0, i]
        after[1, i] = min(bank[1, i] + drift[i] + motion[i] * travel, widest[i])
        after[2, i] = bank[2, i]
    return float(mixed_variance(after, mean, np.empty(bank.shape[1])))


@njit(cache=True, error_model="numpy", nogil=True)
def mixed_variance(bank: Any, mean: float, terms: Any) -> float:
    """Return the variance of a mixture (3, M) about its mean [deg^2], with its terms (M,) in place."""
    for i in range(bank.shape[1]):
        off = bank[0, i] - mean
        terms[i] = bank[2, i] * (bank[1, i] + off * off)
    return float(sum_of(terms))


@njit(cache=True, error_model="numpy", nogil=True)
def sum_of(terms: Any) -> float:
    """Sum of (M,) in eight partial sums, in the same order as the exported C."""
    a, b, c, d, e, f, g, h = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    whole = terms.size - terms.size % 8
    for i in range(0, whole, 8):
        a += terms[i]
        b += terms[i + 1]
        c += terms[i + 2]
        d += terms[i + 3]
        e += terms[i + 4]
        f += terms[i + 5]
        g += terms[i + 6]
        h += terms[i + 7]
    total = ((a + e) + (c + g)) + ((b + f) + (d + h))
    for i in range(whole, terms.size):
        total += terms[i]
    return total

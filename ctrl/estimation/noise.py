"""Adaptive estimation of sensor noise and model error by a bank of Kalman filters, while the loop runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import final

import numpy as np

from hystmpc.core.structs import Struct, struct
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.model import Predictor
from hystmpc.trials.types import Vec

# Without facts a model is assumed to be good: a few samples show the contrary, it takes hundreds to confirm it.
_UNKNOWN = NoiseModel(
    sensor_sigma_deg=0.1, drift_sigma_deg_per_sqrt_s=0.1, motion_sigma_deg_per_sqrt_unit=0.2, model_sigma_deg=0.1
)
_PRIOR_SPREAD = math.log(4.0)  # standard deviation of the logarithm of each sigma about its prior value
_LEAST_SENSOR_DEG = 0.02  # a model of simulated trials without noise gives no information on a real sensor
_SENSOR_FACTORS: Vec = 2.0 ** np.arange(-3.0, 3.1, 0.5)  # factors on the prior value
_DRIFT: Vec = 0.001 * 3.0 ** np.arange(8, dtype=np.float64)  # deg/sqrt(s), up to 2.2
_MOTION: Vec = 0.0016 * 4.0 ** np.arange(7, dtype=np.float64)  # deg over the root of the range of commands
_CLOSE = 0.5  # probability that a model is as close as its file says or closer, at first
_CLOSER: Vec = np.array([1.0, 0.1])  # its error as shares of what the file says, as probable each
_RETURNS_S = 10.0  # time constant with which the error of such a model returns to zero in a hold
_LASTS = 0.01  # share of the range of commands over which that error lasts at least: else it is noise of the sensor
_LEAST_MODEL_DEG = 0.01  # a model of simulated trials has no error there
_SWITCHING_S = 20.0  # mean time between changes of the model's error
_MOST_GAIN, _MOST_GAIN_AT_S = 0.5, 0.04  # in a sample of that time
_FIRST = 100.0  # variance of the first disturbance in those of the sensor: the first measurements decide
_ANYWHERE = 1e12  # deg^2, of a single filter
_TINY = 1e-20  # deg^2: a sigma of zero has no logarithm, and nothing is divided by zero

Sigmas = tuple[float | None, float | None, float | None]
"""Sensor, drift and motion as in `NoiseModel`; None for one that is to be found."""


@final
class NoiseBank:
    """Bank of Kalman filters of one disturbance for different noise levels, weighted by their likelihoods.

        z_k = y_k - model_k = d_k + v_k,   var(v) = sensor^2,   var(d_{k+1} - d_k) = drift^2 dt + motion^2 |du_k|

    Filter i holds one triple of sigmas on a fixed grid. Its disturbance d_i has the variance P_i, at most s_i^2:

        q_i = drift_i^2 dt + motion_i^2 |du|,   f_i^2 = 1 / (1 + q_i / s_i^2)
        d_i <- f_i d_i,   P_i <- f_i^2 (P_i + q_i)
        S_i = P_i + sensor_i^2,   K_i = min(P_i / S_i, 1/2),   d_i <- d_i + K_i (z - d_i)
        P_i <- (1 - K_i)^2 P_i + K_i^2 sensor_i^2,   w_i <- w_i p(z - d_i; S_i) / sum_j w_j p(z - d_j; S_j)
        d = sum_i w_i d_i,   P = sum_i w_i (P_i + (d_i - d)^2)

    Where the model is wrong the disturbance walks anywhere: s is `limit_deg`. Where it is as close to the device as its
    file says, its error returns to zero: s is `model_sigma_deg` of the file, and drift is s (2 / 10 s)^(1/2). Where it
    is closer, s is a tenth of that: a slow walk would foretell such a model better, and it would count as wrong. An
    error lasts over a hundredth of the range R of commands, so that motion is at most s (2 / 0.01 R)^(1/2): one that is
    new in each sample would look like the sensor's noise. Such filters stand at the end of the grid, with every sensor
    and motion. The sum of their weights is the probability that the model is close. It decides how much the estimate of
    now may move a plan, see `WeightsSettings`.

    The weights are the probabilities of the triples (Magill, "Optimal adaptive estimation of sampled stochastic
    processes", IEEE Transactions on Automatic Control 10, 1965). p is Student's density with 7 degrees of freedom and
    variance S_i, so that one outlier has little effect. The model's error may change: in each sample, with probability
    dt / 20 s, drift and motion are drawn anew from their prior, one time in five the sensor too (a jump Markov model,
    Blom and Bar-Shalom, IEEE Transactions on Automatic Control 33, 1988, without their mixing of the filters). No
    weight vanishes, and a wrong model is detected within a second of motion.

    The gain of a bank is bounded because the loop is closed. A plan takes the disturbance for constant, but where the
    model's error answers to the command, as behind a lag that the model lacks, the next command changes it. A gain
    near one then makes an oscillation, which in turn looks like a large drift. It is 1/2 in a sample of 0.04 s, and
    1 - (1/2)^((dt / 0.04 s)^(1/2)) in others: half in 4 ms follows a small unmodelled lag into a limit cycle, half in
    ten such samples learns of a changed device too slowly. K is the filter of internal model
    control, whose robust stability asks for |filter| |relative model error| < 1 at every frequency (Morari and
    Zafiriou, "Robust process control", 1989, section 2.6).

    All sigmas stay on the grid, and every filter is stable. A given sigma is fixed. Where all three are given this is
    the Kalman filter itself, without a bound of its gain. The filters are computed by `core/estimator.c`.

    Args:
        predictor: of the model, with what its file says about these sigmas.
        limit_deg: bound of the disturbance [deg].

    Attributes:
        size: number of filters M.
    """

    def __init__(self, given: Sigmas, predictor: Predictor, limit_deg: float) -> None:
        low, high = predictor.command_range
        known = predictor.noise or _UNKNOWN
        usual = max(known.sensor_sigma_deg, _LEAST_SENSOR_DEG)
        least = known.sensor_resolution_deg / math.sqrt(
            12.0
        )  # error of rounding: equal readings are no better than that
        sensor, by_sensor = _axis(given[0], usual, np.maximum(usual * _SENSOR_FACTORS, least))
        drift, by_drift = _axis(given[1], known.drift_sigma_deg_per_sqrt_s, _DRIFT)
        motion, by_motion = _axis(given[2], known.motion_sigma_deg_per_sqrt_unit, _MOTION / math.sqrt(high - low))
        error = _UNKNOWN.model_sigma_deg if known.model_sigma_deg is None else known.model_sigma_deg
        close = _CLOSER * max(float(error or 0.0), _LEAST_MODEL_DEG)
        self._close = close.size if given[1] is None and given[2] is None else 0
        if self._close:
            drift = np.append(drift, close * math.sqrt(2.0 / _RETURNS_S))
            by_drift = np.append((1.0 - _CLOSE) * by_drift, np.full(close.size, _CLOSE / close.size))
        grid = np.array([axis.ravel() for axis in np.meshgrid(sensor, drift, motion, indexing="ij")])
        self._limit, self._counts = limit_deg, (sensor.size, drift.size, motion.size)
        self._by_sensor, self._by_model = by_sensor, np.outer(by_drift, by_motion).ravel()
        self._switching = predictor.dt / (predictor.dt + _SWITCHING_S)
        slower = (predictor.dt / _MOST_GAIN_AT_S) ** 0.5
        self._most = 1.0 - (1.0 - _MOST_GAIN) ** slower if grid.shape[1] > 1 else 1.0
        self._first = np.full(grid.shape[1], _FIRST * (given[0] or usual) ** 2)
        self._widest = np.full(grid.shape[1], max(limit_deg**2, _TINY) if grid.shape[1] > 1 else _ANYWHERE)
        if self._close:
            near = (slice(None), slice(-self._close, None))
            for table in (self._first, self._widest):
                table.reshape(self._counts)[near] = close[:, None] ** 2
            longest = close[:, None] * math.sqrt(2.0 / (_LASTS * (high - low)))
            grid[2].reshape(self._counts)[near] = np.minimum(motion, longest)
        self._sensor, self._drift, self._motion = grid[0] ** 2, predictor.dt * grid[1] ** 2, grid[2] ** 2
        self._logs = np.log(np.maximum(grid**2, _TINY))
        self.size = grid.shape[1]

    @property
    def greatest_gain(self) -> float:
        """Greatest settled gain K of a disturbance by a measurement in a hold: the bound, or that of given sigmas.

        Of given sigmas it is the Kalman gain, K = P / (P + r) with P = (q + (q^2 + 4 q r)^(1/2)) / 2.
        """
        if self.size > 1:
            return self._most
        r, q = float(self._sensor[0]), float(self._drift[0])
        root = math.sqrt(q * q + 4.0 * q * r)
        return (q + root) / (q + root + 2.0 * r)

    def _tables(self) -> Mapping[str, Vec]:
        """Tables of `hystmpc_noise` in core/estimator.h."""
        _, drifts, motions = self._counts
        models = drifts * motions
        return {
            "sensor_variances": self._sensor[::models],
            "drift_variances": self._drift[:models],
            "motion_variances": self._motion[:models],
            "by_sensor": self._by_sensor,
            "by_model": self._by_model,
            "first_variances": self._first[:models],
            "most_variances": self._widest[:models],
        }

    def struct(self) -> Struct:
        """Return the bank as `hystmpc_noise` of core/estimator.h."""
        sizes = dict(zip(("sensors", "drifts", "motions"), self._counts, strict=True))
        limits = {"close": self._close, "switching": self._switching, "most_gain": self._most, "limit": self._limit}
        return struct("hystmpc_noise", **sizes, **self._tables(), **limits)

    @property
    def sensor_logs(self) -> Vec:
        """Logarithms of the filters' sensor variances [log deg^2] (M,)."""
        return np.asarray(self._logs[0])

    def ahead(self, bank: Vec, travels: Vec, mean: float) -> Vec:
        """Variance about the disturbance d = `mean` at the ends of coming samples without a measurement (H,) [deg^2].

        sum_i w_i (F_ik P_i + (1 - F_ik) s_i^2 + (F_ik^(1/2) d_i - d)^2)
        F_ik = prod_{j<=k} 1 / (1 + q_ij / s_i^2)
        """
        offset, variance, weight = bank
        steps = self._drift + travels[:, None] * self._motion
        logs = -np.cumsum(np.log1p(steps / self._widest), axis=0)  # of the squared factors so far
        grown = np.exp(logs) * variance - np.expm1(logs) * self._widest
        return np.asarray((grown + (np.exp(0.5 * logs) * offset - mean) ** 2) @ weight)


def _axis(given: float | None, known: float, grid: Vec) -> tuple[Vec, Vec]:
    """Values and prior probabilities of one sigma."""
    if given is not None:
        return np.array([given]), np.ones(1)
    centre = min(max(known, grid[0]), grid[-1])
    weights = np.exp(-0.5 * (np.log(grid / centre) / _PRIOR_SPREAD) ** 2)
    return grid, weights / weights.sum()

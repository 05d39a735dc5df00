"""Online learning of a model error: basis functions, and a bank of Kalman filters that estimate their weights.

There is one filter for each drive of a grid. The basis is the response of a drive and a hysteresis operator with free
weights to the command:

    theta = m + w_c (m - m_0) + sum_i w_i f_i(v),   v = lag_tau(u(t - D))

m is the model's angle, v the travel behind a drive with the lag tau and the delay D, both as shares of the command's
range. The f_i are differences from the start: v itself, plays of v (a Prandtl-Ishlinskii operator), one-sided dead
zones of v (a superposition operator; both Kuhnen, "Modeling, identification and compensation of complex hysteretic
nonlinearities", European Journal of Control 9, 2003), plays times v, slow followers of v (creep), and the rate of v,
which stands for a drive between two of the grid. `core/basis.c` and `core/learning.c` compute them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.core.structs import Struct, struct
from hystmpc.trials.types import Vec

from ..command import replace
from ..mpc_settings import AdaptationSettings

LAGS_S: Vec = np.array([0.0, 0.02, 0.045, 0.075, 0.11, 0.15, 0.2, 0.26])
DELAYS = 6
"""Delays of 0 to 5 samples."""
_CREEPS_S: Vec = np.array([0.8, 4.0])
_PLAYS, _ZONES, _WEIGHTED = 5, 8, 4  # as core/learned_state.h has them; the widest plays also count times v
FEATURES = 1 + _PLAYS + _ZONES + _WEIGHTED + _CREEPS_S.size + 1
MEMORY = 1 + _PLAYS + _CREEPS_S.size
"""Entries of the memory behind one lag: v, plays, slow followers."""
LEARNED_SIZE = MEMORY + DELAYS + 1 + FEATURES + 5
"""Entries of the learned part's state: memory, queue of the last commands, weights, v0, side, m_0, share of the lag in
a sample, delay [samples]; commands as shares of the range, the newest first."""
OF_WEIGHTS = slice(MEMORY + DELAYS, LEARNED_SIZE - 5)
_SHARES: Vec = np.concatenate(
    [[0.7], np.full(_PLAYS, 0.5), np.full(_ZONES, 1.0), np.full(_WEIGHTED, 0.5), [0.2, 0.2], [0.3]]
)  # standard deviations of the weights beside each other; their level is a setting

DRIVES = LAGS_S.size * DELAYS
SIZE = FEATURES + 2
"""Entries of z: offset, w_c, weights."""
PLAYS = slice(3, 3 + _PLAYS)
"""Entries of z that are weights of the plays, the narrowest first."""
_START, _QUEUE = 3, 3 + DELAYS  # ends of the start and of the queue in the past
_BLOCK_S, _LEAST_BLOCK = 0.24, 3
_SENSOR, _LEAST_SENSOR_DEG = 2.0, 0.05  # assumed noise is larger than the sensor's, since the basis is not exact
_OFFSET_DEG, _GAIN, _DRIFT = 10.0, 1.0, 0.3  # standard deviations of offset, w_c; and of a drift [deg/sqrt(s)]
_KEPT = 0.8  # of a score in a block
_GAIN_TO_ACT = 0.6  # share of the model's score by which a forecast has to be better before it acts
_FLOOR = 0.5  # standard deviations of the sensor: no model has to predict better

_VECTOR = DELAYS, SIZE, LAGS_S.size
FILTERS = np.dtype(
    [
        ("z", "f8", _VECTOR),
        ("covariance", "f8", (DELAYS, SIZE * (SIZE + 1) // 2, LAGS_S.size)),
        ("frozen", "f8", _VECTOR),
        ("references", "f8", 2),
        ("sums", "f8", DRIVES + 2),
        ("scores", "f8", DRIVES + 2),
        ("forecast_error", "f8"),
        ("share", "f8"),
        ("waited", "f8"),
        ("travelled", "f8"),
        ("count", np.intc),
        ("blocks", np.intc),
        ("best", np.intc),
    ],
    align=True,
)
"""Layout of `BankState.filters`, that of `hystmpc_filters` in core/learned_state.h."""
_OF_ERROR, _OF_SHARE = (FILTERS.fields[name][1] // 8 for name in ("forecast_error", "share"))  # type: ignore[index]


@dataclass(frozen=True, eq=False)
class BankState:
    """Snapshot of the bank with its H drives: drive number lag * DELAYS + delay; L lags stand side by side.

    Attributes:
        past: start and queue, then the memory behind each lag in this and the last samples, the newest first
            (M, MEMORY, L).
        filters: numbers of the filters and of their forecasts, laid out as `FILTERS`.
    """

    past: Vec
    filters: Vec

    def _entry(self, name: str) -> Any:
        return self.filters.view(FILTERS)[name][0]

    @property
    def queue(self) -> Vec:
        """Commands of the last samples as shares of the range, the newest first (DELAYS,)."""
        return self.past[_START:_QUEUE]

    @property
    def z(self) -> Vec:
        """Offset [deg], w_c and weights [deg] of every drive (DELAYS, K, L)."""
        return np.asarray(self._entry("z"))

    @property
    def covariance(self) -> Vec:
        """Covariance of their errors (DELAYS, K (K + 1) / 2, L): lower triangles, row by row."""
        return np.asarray(self._entry("covariance"))

    @property
    def sums(self) -> Vec:
        """Squared errors of the forecasts in this block (H + 2,): drives, model alone, last angle held [deg^2]."""
        return np.asarray(self._entry("sums"))

    @property
    def scores(self) -> Vec:
        """Means of these over the past blocks with motion (H + 2,) [deg^2]."""
        return np.asarray(self._entry("scores"))

    @property
    def forecast_error(self) -> float:
        """Error of the better forecast, of model or best drive, over that of none (root mean squares).

        It is at most 1.2 in each block, smoothed over the last blocks with motion; 0 at first.
        """
        return self.filters.item(_OF_ERROR)

    @property
    def share(self) -> float:
        """Share with which the best drive acts, 0 to 1."""
        return self.filters.item(_OF_SHARE)

    @property
    def blocks(self) -> int:
        """Number of blocks with motion so far."""
        return int(self._entry("blocks"))

    @property
    def best(self) -> int:
        """Number of the drive with the best forecasts."""
        return int(self._entry("best"))

    @property
    def delay(self) -> int:
        """Delay of the best drive [samples]."""
        return self.best % DELAYS

    @property
    def weights(self) -> Vec:
        """w_c and the weights of the best drive (1 + FEATURES,), times the share."""
        return np.asarray(self.share * self.z[self.delay, 1:, self.best // DELAYS])


@final
class FilterBank:
    """Kalman filters of z = (d, w_c, w) for every drive of the grid, with scores of their forecasts.

        y_k = m_k + h_k' z_k + v_k,   h = (1, m - m_0, f),   var(v) = r
        s = h' P h + r,  z <- z + P h (y - m - h' z) / s,  P <- P - P h h' P / s,  P <- P + Q

    At first P is the variances of free weights, and c c' for each change c of the device that is likely as a whole:
    a few measurements determine how far the friction has grown, or how late a drive answers. By Q the offset
    drifts, but the weights change with the travel of the command only: in a hold nothing is forgotten, and an error
    of more than three standard deviations counts as a jump of the offset. Every 0.24 s all z are frozen, and until
    the next time each drive predicts the angles from the commands alone. The model with its disturbance does too,
    and so does the last angle. The mean squares of the errors, over the blocks in which the angle moved, are the
    scores; a block that began before anything was learned does not count, since all forecasts are the model's
    there. The learned part of the drive with the best score acts with the share

        s = (1 - (score + e) / (score of the model + e) - 0.6) / 0.3, within 0 and 1,   e = (sensor / 2)^2

    so that it has to predict clearly better than the model, and fades where it does not. With frames 0.3 takes the
    place of 0.6, and their noise that of the sensor: between frames little else corrects the model.

    Args:
        command_range: ends of the commands [mm or bar].
        scale: angle over the whole range [deg].
        sensor_deg: standard deviation of the sensor [deg].
        delay: samples of delay that the estimator takes care of.
        likely: changes c of z that are likely as a whole (2, K), see `likely_changes`; None for free weights alone.
        drift: standard deviation of the offset after one second [deg].
    """

    def __init__(
        self,
        dt: float,
        command_range: tuple[float, float],
        scale: float,
        sensor_deg: float,
        delay: int,
        settings: AdaptationSettings,
        likely: Vec | None = None,
        drift: float = _DRIFT,
    ) -> None:
        low, high = command_range
        sensor = max(sensor_deg, _LEAST_SENSOR_DEG)
        prior = np.concatenate([[_OFFSET_DEG, _GAIN], settings.sigma_share * scale * _SHARES]) ** 2
        growth = [drift**2 * dt, *np.zeros(SIZE - 1)]
        walk = [0.0, *(settings.walk_share**2 * prior[1:]).tolist()]
        lags = [1.0 if tau == 0 else -math.expm1(-dt / tau) for tau in LAGS_S.tolist()]
        creeps = -np.expm1(-dt / _CREEPS_S)
        known = struct("hystmpc_basis", creeps=creeps, pace=1.0 / dt, low=low, span=high - low)
        self._learner = struct(
            "hystmpc_learner",
            basis=known,
            lags=lags,
            prior=prior,
            likely=np.zeros(2 * SIZE) if likely is None else likely.ravel(),
            growth=growth,
            walk=walk,
            noise=(_SENSOR * sensor) ** 2,
            floor=(_FLOOR * sensor) ** 2,
            kept=_KEPT,
            gain=_GAIN_TO_ACT,
            scale=scale,
            delay=delay,
            block=max(round(_BLOCK_S / dt), _LEAST_BLOCK),
        )
        self._scale = scale
        self._past = _QUEUE + (DELAYS + 1 + delay) * MEMORY * LAGS_S.size

    def struct(self) -> Struct:
        """Return the bank as `hystmpc_learner` of core/learning.h."""
        return self._learner

    def init(self, angle: float, u: float, y: float) -> BankState:
        """Return the state at rest under the command u, the model at `angle` and the measurement at `y` [deg].

        A device that rests near one end of its command has come from the other side.
        """
        state = BankState(np.empty(self._past), np.zeros(FILTERS.itemsize // 8))
        engine().filters_init(self._learner.address, state.past, state.filters, angle, u, y)
        return state

    def reach(self, state: BankState) -> float:
        """Possible change of the angle under the last commands [deg]: twice the value from the mean slope."""
        shares = state.queue.tolist()
        return 2.0 * self._scale * (max(shares) - min(shares))

    def advance(self, state: BankState, u: float) -> BankState:
        """Time update by one sample under the command u."""
        past = state.past.copy()
        engine().filters_advance(self._learner.address, past, u)
        return replace(state, past=past)

    def correct(self, state: BankState, y: float, angle: float, disturbance: float) -> BankState:
        """Measurement update of all filters and scores.

        Args:
            angle: of the model at the instant of the measurement `y` [deg].
            disturbance: of the model alone, before this measurement is used [deg].
        """
        filters = state.filters.copy()
        engine().filters_correct(self._learner.address, state.past, filters, y, angle, disturbance)
        return replace(state, filters=filters)

    def acting(self, state: BankState, angles: Sequence[float]) -> tuple[Vec, Vec]:
        """Learned part of the best drive, times the share.

        Args:
            angles: of the model in the last samples, the present one last (delay + 1,) [deg].

        Returns:
            What it adds to each of the angles (delay + 1,) [deg]; the learned part of a model's state (LEARNED_SIZE,).
        """
        both = np.empty(LEARNED_SIZE + len(angles))
        both[LEARNED_SIZE:] = angles
        engine().filters_state(self._learner.address, state.past, state.filters, both)
        return both[LEARNED_SIZE:], both[:LEARNED_SIZE]

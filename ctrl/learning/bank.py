"""Online learning of a model error: basis functions, and a bank of Kalman filters that estimate their weights.

There is one filter for each drive of a grid. The basis is the response of a drive and a hysteresis operator with free
weights to the command:

    theta = m + w_c (m - m_0) + sum_i w_i f_i(v),   v = lag_tau(u(t - D))

m is the model's angle, v the travel behind a drive with the lag tau and the delay D, both as shares of the command's
range. The f_i are differences from the start: v itself, plays of v (a Prandtl-Ishlinskii operator), one-sided dead
zones of v (a superposition operator; both Kuhnen, "Modeling, identification and compensation of complex hysteretic
nonlinearities", European Journal of Control 9, 2003), plays times v, slow followers of v (creep), and the rate of v,
which stands for a drive between two of the grid. All functions work on one flat state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from hystmpc.models.kernels.numba_ import njit
from hystmpc.trials.types import Vec

from ..command import replace
from ..mpc_settings import AdaptationSettings

LAGS_S: Vec = np.array([0.0, 0.02, 0.045, 0.075, 0.11, 0.15, 0.2, 0.26])
DELAYS = 6
"""Delays of 0 to 5 samples."""
RADII: Vec = np.array([0.008, 0.02, 0.05, 0.1, 0.2])
ZONES: Vec = np.array([0.05, 0.1, 0.16, 0.24, 0.34, 0.46, 0.6, 0.78])
CREEPS_S: Vec = np.array([0.8, 4.0])
_WEIGHTED = 4  # plays, the widest, that also count times v
_RATE_S = 0.1  # unit of the rate of v
_EDGE = 1e-12
FEATURES = 1 + RADII.size + ZONES.size + _WEIGHTED + CREEPS_S.size + 1
MEMORY = 1 + RADII.size + CREEPS_S.size
"""Entries of the memory behind one lag: v, plays, slow followers."""
LEARNED_SIZE = MEMORY + DELAYS + 1 + FEATURES + 5
"""Entries of the learned part's state: memory, queue of the last commands, weights, v0, side, m_0, share of the lag in
a sample, delay [samples]; commands as shares of the range, the newest first."""
OF_WEIGHTS, OF_START = slice(MEMORY + DELAYS, LEARNED_SIZE - 5), slice(LEARNED_SIZE - 5, LEARNED_SIZE)
SHARES: Vec = np.concatenate(
    [[0.7], np.full(RADII.size, 0.5), np.full(ZONES.size, 1.0), np.full(_WEIGHTED, 0.5), [0.2, 0.2], [0.3]]
)
"""Standard deviations of the weights beside each other; their level is a setting."""


def basis_numbers() -> Mapping[str, float | Vec]:
    """Return the numbers of the basis, for code generation."""
    return {
        "memory": MEMORY,
        "weights": 1 + FEATURES,
        "delays": DELAYS,
        "plays": RADII.size,
        "zones": ZONES.size,
        "creeps": CREEPS_S.size,
        "weighted": _WEIGHTED,
        "radii": RADII,
        "zone_starts": ZONES,
        "rate_s": _RATE_S,
        "edge": _EDGE,
    }


def first_memory(v: float, side: float) -> Vec:
    """Return the memory (MEMORY,) at rest at the travel v, approached from the side +1 (above) or -1."""
    return np.concatenate([[v], v + side * RADII, np.full(CREEPS_S.size, v)])


def lag_shares(dt: float) -> Vec:
    """Unit step response after one sample of each first-order lag of the basis."""
    return np.array([1.0 if tau == 0 else -math.expm1(-dt / tau) for tau in LAGS_S])


def creep_shares(dt: float) -> Vec:
    """Response of each slow follower to a unit step after one sample."""
    return np.asarray(-np.expm1(-dt / CREEPS_S))


@njit(cache=True, error_model="numpy", nogil=True)
def advance_memory(memory: Any, x: float, share: float, creeps: Any) -> None:
    """Advance the memory (MEMORY,) by one sample under the delayed command x, in place."""
    count = RADII.size
    memory[0] += share * (x - memory[0])
    v = memory[0]
    for i in range(count):
        memory[1 + i] = min(max(memory[1 + i], v - RADII[i]), v + RADII[i])
    for j in range(CREEPS_S.size):
        memory[1 + count + j] += creeps[j] * (v - memory[1 + count + j])


@njit(cache=True, error_model="numpy", nogil=True)
def features(memory: Any, before: float, v0: float, side: float, pace: float, out: Any) -> None:
    """Compute the features f (FEATURES,) of a memory."""
    count, v = RADII.size, memory[0]
    out[0] = v - v0
    at = 1
    for i in range(count):
        out[at] = memory[1 + i] - v0 - side * RADII[i]
        at += 1
    for i in range(ZONES.size):
        out[at] = max(v - ZONES[i], 0.0) - max(v0 - ZONES[i], 0.0)
        at += 1
    for i in range(count - _WEIGHTED, count):
        out[at] = (memory[1 + i] - v) * v - side * RADII[i] * v0
        at += 1
    for j in range(CREEPS_S.size):
        out[at] = v - memory[1 + count + j]
        at += 1
    out[at] = (v - before) * pace * _RATE_S


@njit(cache=True, error_model="numpy", nogil=True)
def acting_command(part: Any, plan: Any, k: int, low: float, span: float) -> Any:
    """Delayed command in sample k of a plan (H,), as a share of the range."""
    delay = int(part[LEARNED_SIZE - 1])
    return part[MEMORY + delay - 1 - k] if k < delay else (plan[k - delay] - low) / span


@njit(cache=True, error_model="numpy", nogil=True)
def add_learned(part: Any, pace: float, creeps: Any, low: float, span: float, plans: Any, angles: Any) -> None:
    """Add the learned part to the angles (N, H) along plans (N, H), in place: m + w_c (m - m_0) + sum_i w_i f_i.

    Args:
        part: the learned part's state (LEARNED_SIZE,).
        low, span: least command, and the range of commands [command unit].
    """
    weights, start, horizon = part[OF_WEIGHTS], part[OF_START], plans.shape[1]
    now, f = np.empty(MEMORY), np.empty(FEATURES)
    for n in range(plans.shape[0]):
        now[:] = part[:MEMORY]
        for k in range(horizon):
            before = now[0]
            advance_memory(now, acting_command(part, plans[n], k, low, span), start[3], creeps)
            features(now, before, start[0], start[1], pace, f)
            total = weights[0] * (angles[n, k] - start[2])
            for i in range(FEATURES):
                total += weights[1 + i] * f[i]
            angles[n, k] += total


@njit(cache=True, error_model="numpy", nogil=True)
def advance_slopes(before: Any, now: Any, acting: int, share: float, creeps: Any, by: Any) -> None:
    """Advance the derivatives of a memory by the commands of a plan by one sample, in place: by (MEMORY + 1, H).

    The last row is that of v one sample ago. A play at its edge counts as driven.

    Args:
        acting: number of the plan's command that acts in this sample; negative where none does yet.
    """
    count, v = RADII.size, now[0]
    for j in range(acting + 1):
        by[MEMORY, j] = by[0, j]
        by[0, j] *= 1.0 - share
    if acting >= 0:
        by[0, acting] = share
    for i in range(count):
        if v - RADII[i] >= before[1 + i] - _EDGE or v + RADII[i] <= before[1 + i] + _EDGE:
            for j in range(acting + 1):
                by[1 + i, j] = by[0, j]
    for c in range(CREEPS_S.size):
        for j in range(acting + 1):
            by[1 + count + c, j] += creeps[c] * (by[0, j] - by[1 + count + c, j])


@njit(cache=True, error_model="numpy", nogil=True)
def slopes_by_memory(now: Any, weights: Any, pace: float, out: Any) -> None:
    """Compute the derivatives of sum_i w_i f_i by the memory and by v one sample ago (MEMORY + 1,)."""
    count, v = RADII.size, now[0]
    out[:] = 0.0
    out[0] = weights[1]
    for i in range(count):
        out[1 + i] = weights[2 + i]
    at = 2 + count
    for i in range(ZONES.size):
        if v > ZONES[i]:
            out[0] += weights[at + i]
    at += ZONES.size
    for i in range(_WEIGHTED):
        play = 1 + count - _WEIGHTED + i
        out[play] += weights[at + i] * v
        out[0] += weights[at + i] * (now[play] - 2.0 * v)
    at += _WEIGHTED
    for c in range(CREEPS_S.size):
        out[0] += weights[at + c]
        out[1 + count + c] -= weights[at + c]
    rate = weights[FEATURES] * pace * _RATE_S
    out[0] += rate
    out[MEMORY] -= rate


@njit(cache=True, error_model="numpy", nogil=True)
def add_slopes(part: Any, pace: float, creeps: Any, low: float, span: float, plan: Any, jacobian: Any) -> None:
    """Add the learned part to the model's jacobian (H, H) along one plan (H,), in place; see `add_learned`."""
    weights, share, horizon = part[OF_WEIGHTS], part[LEARNED_SIZE - 2], plan.size
    now, before, slopes = part[:MEMORY].copy(), np.empty(MEMORY), np.empty(MEMORY + 1)
    by, row = np.zeros((MEMORY + 1, horizon)), np.empty(horizon)
    for k in range(horizon):
        before[:] = now
        advance_memory(now, acting_command(part, plan, k, low, span), share, creeps)
        advance_slopes(before, now, k - int(part[LEARNED_SIZE - 1]), share, creeps, by)
        slopes_by_memory(now, weights, pace, slopes)
        row[: k + 1] = 0.0
        for i in range(MEMORY + 1):
            for j in range(k + 1):
                row[j] += slopes[i] * by[i, j]
        for j in range(k + 1):
            jacobian[k, j] = (1.0 + weights[0]) * jacobian[k, j] + row[j] / span


DRIVES = LAGS_S.size * DELAYS
_SIZE = FEATURES + 2  # of z: offset, w_c, weights
_MODEL, _NOTHING = DRIVES, DRIVES + 1  # rows of the scores after the drives
_BLOCK_S, _LEAST_BLOCK = 0.24, 3
_KEPT = 0.8  # forgetting factor of a score, per block
_BETTER = 0.8  # share of the present score at which another drive is taken
# Gain over the model's score at which the learned part begins to act, and the further gain for its full effect.
_LEAST_GAIN, _FULL_GAIN = 0.6, 0.3
_MOVING = 2.0  # variances of the filters by which an angle has to move in a block that counts
_SENSOR, _LEAST_SENSOR_DEG = 2.0, 0.05  # assumed noise is larger than the sensor's, since the basis is not exact
_OFFSET_DEG, _GAIN, _DRIFT = 10.0, 1.0, 0.3  # standard deviations of offset, w_c; and of a drift [deg/sqrt(s)]
_RECENT = 0.8  # forgetting factor of the errors that the supervisor uses, per block
_WORST = 1.2  # error of a block is limited to this: one bad block is weak evidence
_SURPRISE = 9.0  # variances of an error in a hold, from which on it is an offset that has jumped
_FLOOR = 0.5  # standard deviations of the sensor: no model has to predict better


@dataclass(frozen=True, eq=False)
class BankState:
    """Snapshot of the bank with its H drives, ordered by lag and, within a lag, by delay.

    Attributes:
        history: memory behind each lag of the grid, of this and the last samples, the newest first (M, L, MEMORY).
        queue: commands of the last samples as shares of the range, the newest first (DELAYS,).
        z: offset [deg], w_c and weights [deg] of every drive (H, K).
        covariance: of their errors (H, K, K).
        frozen: z at the beginning of the block of forecasts (H, K).
        references: at the same instant, the model's disturbance and the measured angle [deg].
        sums: squared errors of the forecasts in this block (H + 2,): drives, model alone, last angle held [deg^2].
        scores: means of these over the past blocks with motion (H + 2,) [deg^2].
        forecast_error: of the better forecast, of model or best drive, over that of none (root mean squares); at most
            1.2 in each block, smoothed over the last blocks with motion; 0 at first.
        best: the drive with the best forecasts.
    """

    history: Vec
    queue: Vec
    start: Vec
    z: Vec
    covariance: Vec
    frozen: Vec
    references: tuple[float, float]
    sums: Vec
    scores: Vec
    forecast_error: float
    count: int
    blocks: int
    best: int
    share: float

    @property
    def lag(self) -> int:
        """Number of the best drive's lag in the grid."""
        return self.best // DELAYS

    @property
    def delay(self) -> int:
        """Delay of the best drive [samples]."""
        return self.best % DELAYS

    @property
    def weights(self) -> Vec:
        """w_c and the weights of the best drive (1 + FEATURES,), times the share."""
        return np.asarray(self.share * self.z[self.best, 1:])


@final
class FilterBank:
    """Kalman filters of z = (d, w_c, w) for every drive of the grid, with scores of their forecasts.

        y_k = m_k + h_k' z_k + v_k,   h = (1, m - m_0, f),   var(v) = r
        s = h' P h + r,  z <- z + P h (y - m - h' z) / s,  P <- P - P h h' P / s,  P <- P + Q

    By Q the offset drifts, but the weights change with the travel of the command only: in a hold nothing is forgotten,
    and an error of more than three standard deviations counts as a jump of the offset. Every 0.24 s all z are frozen,
    and until the next time each drive predicts the angles from the commands alone. The model with its disturbance does
    too, and so does the last angle. The mean squares of the errors, over the blocks in which the angle moved, are the
    scores. The learned part of the drive with the best score acts with the share

        s = (1 - (score + e) / (score of the model + e) - 0.6) / 0.3, within 0 and 1,   e = (sensor / 2)^2

    so that it has to predict clearly better than the model, and fades where it does not.

    Args:
        command_range: ends of the commands [mm or bar].
        scale: angle over the whole range [deg].
        sensor_deg: standard deviation of the sensor [deg].
        delay: samples of delay that the estimator takes care of.
    """

    def __init__(
        self,
        dt: float,
        command_range: tuple[float, float],
        scale: float,
        sensor_deg: float,
        delay: int,
        settings: AdaptationSettings,
    ) -> None:
        self.dt, self._low, self._span = dt, command_range[0], command_range[1] - command_range[0]
        self._scale = scale
        self.lags, self.creeps = lag_shares(dt), creep_shares(dt)
        self._delay, self._block = delay, max(round(_BLOCK_S / dt), _LEAST_BLOCK)
        self._noise = (_SENSOR * max(sensor_deg, _LEAST_SENSOR_DEG)) ** 2
        self._floor = (_FLOOR * max(sensor_deg, _LEAST_SENSOR_DEG)) ** 2
        self._prior = np.concatenate([[_OFFSET_DEG, _GAIN], settings.sigma_share * scale * SHARES]) ** 2
        self._growth = np.concatenate([[_DRIFT**2 * dt], np.zeros(_SIZE - 1)])
        self._walk = np.concatenate([[0.0], settings.walk_share**2 * self._prior[1:]])

    def numbers(self) -> Mapping[str, float | Vec]:
        """Return the numbers of the bank and of its basis, for code generation."""
        return {
            **basis_numbers(),
            "drives": DRIVES,
            "lags": LAGS_S.size,
            "unknowns": _SIZE,
            "triangle": _SIZE * (_SIZE + 1) // 2,
            "history": DELAYS + 1 + self._delay,
            "block": self._block,
            "lag_shares": self.lags,
            "creep_shares": self.creeps,
            "prior": self._prior,
            "growth": self._growth,
            "walk": self._walk,
            "learning_noise": self._noise,
            "floor": self._floor,
            "scale": self._scale,
            "range_low": self._low,
            "range_span": self._span,
            "pace": 1.0 / self.dt,
            "moving": _MOVING,
            "kept": _KEPT,
            "better": _BETTER,
            "least_gain": _LEAST_GAIN,
            "full_gain": _FULL_GAIN,
            "recent": _RECENT,
            "worst": _WORST,
            "surprise": _SURPRISE,
        }

    def share_of_range(self, u: Vec | float) -> Any:
        """Convert commands to shares of the range."""
        return (u - self._low) / self._span

    def init(self, angle: float, u: float, y: float) -> BankState:
        """Return the state at rest under the command u, the model at `angle` and the measurement at `y` [deg]."""
        v = float(self.share_of_range(u))
        side = 1.0 if v < 0.5 else -1.0  # a device that rests near one end of its command has come from the other side
        z = np.zeros((DRIVES, _SIZE))
        z[:, 0] = y - angle
        return BankState(
            history=np.broadcast_to(first_memory(v, side), (DELAYS + 1 + self._delay, LAGS_S.size, MEMORY)).copy(),
            queue=np.full(DELAYS, v),
            start=np.array([v, side, angle]),
            z=z,
            covariance=np.broadcast_to(np.diag(self._prior), (DRIVES, _SIZE, _SIZE)).copy(),
            frozen=z,
            references=(y - angle, y),
            sums=np.zeros(DRIVES + 2),
            scores=np.zeros(DRIVES + 2),
            forecast_error=0.0,
            count=0,
            blocks=0,
            best=0,
            share=0.0,
        )

    def reach(self, state: BankState) -> float:
        """Possible change of the angle under the last commands [deg]: twice the value from the mean slope."""
        shares = state.queue.tolist()
        return 2.0 * self._scale * (max(shares) - min(shares))

    def advance(self, state: BankState, u: float) -> BankState:
        """Time update by one sample under the command u."""
        history = np.empty_like(state.history)
        queue = np.empty_like(state.queue)
        advance_history(
            state.history, state.queue, float(self.share_of_range(u)), self.lags, self.creeps, history, queue
        )
        return replace(state, history=history, queue=queue)

    def correct(self, state: BankState, y: float, angle: float, disturbance: float) -> BankState:
        """Measurement update of all filters and scores.

        Args:
            angle: of the model at the instant of the measurement `y` [deg].
            disturbance: of the model alone, before this measurement is used [deg].
        """
        z, covariance, sums = state.z.copy(), np.empty_like(state.covariance), state.sums.copy()
        travel = abs(float(state.history[self._delay, 0, 0] - state.history[self._delay + 1, 0, 0]))
        correct_filters(
            z,
            state.covariance,
            state.frozen,
            state.history,
            self._delay,
            state.start,
            y,
            angle,
            self._noise,
            self._prior,
            self._growth,
            self._walk,
            travel,
            1.0 / self.dt,
            sums,
            covariance,
        )
        disturbed, last = state.references
        sums[_MODEL] += (y - angle - disturbed) ** 2
        sums[_NOTHING] += (y - last) ** 2
        after = replace(state, z=z, covariance=covariance, sums=sums, count=state.count + 1)
        if after.count < self._block:
            return after
        judged = self._judged(after, sums / after.count)
        return replace(judged, sums=np.zeros(DRIVES + 2), count=0, frozen=z, references=(disturbance, y))

    def _judged(self, state: BankState, means: Vec) -> BankState:
        """Update scores, best drive and share by the mean square errors (H + 2,) of a block of forecasts [deg^2]."""
        if means[_NOTHING] <= _MOVING * self._noise:
            return state
        kept = min(_KEPT, state.blocks / (state.blocks + 1.0))
        scores, best = kept * state.scores + (1.0 - kept) * means, state.best
        first = int(np.argmin(scores[:DRIVES]))
        best = first if scores[first] < _BETTER * scores[best] else best
        gained = 1.0 - (float(scores[best]) + self._floor) / (float(scores[_MODEL]) + self._floor)
        off = min(math.sqrt(min(means[_MODEL], means[best]) / means[_NOTHING]), _WORST)
        return replace(
            state,
            scores=scores,
            forecast_error=_RECENT * state.forecast_error + (1.0 - _RECENT) * off,
            blocks=state.blocks + 1,
            best=best,
            share=min(max((gained - _LEAST_GAIN) / _FULL_GAIN, 0.0), 1.0),
        )

    def added(self, state: BankState, angle: float, back: int) -> float:
        """Learned part of the best drive, relative to the model's angle of `back` samples ago [deg]."""
        if state.share == 0:
            return 0.0
        at, best, pace = state.delay + back, state.best, 1.0 / self.dt
        return float(learned_angle(state.history, at, state.lag, state.start, pace, state.share, state.z[best], angle))


@njit(cache=True, error_model="numpy", nogil=True)
def advance_history(before: Any, commands: Any, x: float, lags: Any, creeps: Any, history: Any, queue: Any) -> None:
    """Advance history and queue by one sample under the command x, a share of the range."""
    history[1:] = before[:-1]
    queue[1:] = commands[:-1]
    queue[0] = x
    for t in range(lags.size):
        history[0, t] = before[0, t]
        advance_memory(history[0, t], x, lags[t], creeps)


@njit(cache=True, error_model="numpy", nogil=True)
def learned_angle(history: Any, at: int, lag: int, start: Any, pace: float, share: float, z: Any, angle: float) -> Any:
    """Learned part z (K,) times share at the model's angle of `at` samples ago, behind a lag of the grid [deg]."""
    before, f = history[at + 1 if at + 1 < history.shape[0] else at, lag, 0], np.empty(FEATURES)
    features(history[at, lag], before, start[0], start[1], pace, f)
    total = z[1] * (angle - start[2])
    for i in range(FEATURES):
        total += z[2 + i] * f[i]
    return share * total


@njit(cache=True, error_model="numpy", nogil=True)
def correct_filters(
    z: Any,
    covariance: Any,
    frozen: Any,
    history: Any,
    delay: int,
    start: Any,
    y: float,
    angle: float,
    noise: float,
    prior: Any,
    growth: Any,
    walk: Any,
    travel: float,
    pace: float,
    sums: Any,
    after: Any,
) -> None:
    """Measurement update of every drive: z (H, K) and sums of forecast errors in place, covariance in `after`."""
    h = np.empty(_SIZE)
    for n in range(z.shape[0]):
        lag, at = n // DELAYS, n % DELAYS + delay
        features(history[at, lag], history[at + 1, lag, 0], start[0], start[1], pace, h[2:])
        h[0], h[1] = 1.0, angle - start[2]
        error, forecast = y - angle, y - angle
        for a in range(_SIZE):
            error -= h[a] * z[n, a]
            forecast -= h[a] * frozen[n, a]
        sums[n] += forecast * forecast
        correct_filter(z[n], covariance[n], h, error, noise, prior, travel == 0.0, after[n])
        for a in range(_SIZE):
            grown = after[n, a, a] + growth[a] + walk[a] * travel
            after[n, a, a] = min(grown, max(prior[a], after[n, a, a]))


@njit(cache=True, error_model="numpy", nogil=True)
def correct_filter(z: Any, p: Any, h: Any, error: float, noise: float, prior: Any, still: bool, after: Any) -> None:
    """Measurement update of one drive with covariance p (K, K): z (K,) in place, its new covariance in `after`.

    K is a compile-time constant: such short loops are vectorised only then.

    Args:
        still: whether the command rests: the weights are then constant, and a large error is a jump of the offset.
    """
    spread, variance, jump = np.zeros(_SIZE), noise, 0.0
    for b in range(_SIZE):  # not `p @ h`: its last digits, which are learned from, differ between libraries
        for a in range(_SIZE):
            spread[a] += p[b, a] * h[b]
    for a in range(_SIZE):
        variance += h[a] * spread[a]
    if not (noise <= variance < np.inf and abs(error) < np.inf):  # rounding has eaten the covariance
        after[:] = 0.0
        for a in range(_SIZE):
            after[a, a] = prior[a]
        return
    if still and error * error > _SURPRISE * variance:
        jump = error * error
        spread[0] += jump
        variance += jump
    shrunk = 1.0 / math.sqrt(variance)
    for a in range(_SIZE):
        spread[a] *= shrunk  # twice the same factor: the covariance stays symmetric to the last bit
        z[a] += spread[a] * (shrunk * error)
    for a in range(_SIZE):
        for b in range(_SIZE):
            after[a, b] = p[a, b] - spread[a] * spread[b]
    after[0, 0] = p[0, 0] + jump - spread[0] * spread[0]

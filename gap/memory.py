"""What a residual remembers: features of the command's past, and what they explain on trials held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hystmpc.trials.segments import Motion, Segments
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Mat, Vec

from .floor import require_residuals
from .motion_type import command_segments

MEMORIES = ("speed", "since_reversal", "hold_age", "travel", "clock")

_AGES_S = (0.1, 0.4, 1.5, 6.0, 25.0)
_LAGS_S = (0.04, 0.08, 0.16, 0.32, 0.64, 1.28)
_WIDTHS = (0.02, 0.05, 0.1, 0.18, 0.3, 0.45)  # of the command's range
_RIDGES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)  # of the mean eigenvalue of the features' Gram matrix
_RIDGE = 1e-3
_TYPICAL = 0.3  # speed [1/s] of the command in ranges
_RANDOM = 160  # random features
_PARTS = 4  # a single trial is cut into


def memory_gains(trials: Sequence[Trial], residuals: Sequence[Vec], loop_width: float) -> dict[str, float]:
    """Share of the residual's energy about its mean that each memory explains held out, by name; below 0 if none.

    Ridge regression on a few features of speed (|v|, v, sign), time since the last reversal and age of the hold
    (decaying exponentials times the last direction), travel since the reversal (in loop widths) and in all, and the
    clock, over all trials but one, applied to that one. A trial that stands alone is cut into four.

    Args:
        trials: uniform, at one rate, in recording order.
        residuals: (T,) each [deg].
        loop_width: width of the hysteresis loop along the command [cmd].

    Raises:
        GapError: if residuals do not fit the trials or are not finite.
        LogError: if a trial is not uniform.
    """
    require_residuals(trials, residuals)
    views = [_View(trial, loop_width) for trial in trials]
    clocks = np.concatenate([[0.0], np.cumsum([trial.duration_s for trial in trials])])
    targets = _folded(residuals)
    total = float(_held_out([np.zeros((y.size, 0)) for y in targets], targets, (_RIDGE,)).sum())
    gains = {}
    for name in MEMORIES:
        rows = [view.features(name, clock) for view, clock in zip(views, clocks[:-1], strict=True)]
        missed = _held_out(_folded(rows), targets, (_RIDGE,))[0]
        gains[name] = float(np.clip(1 - missed.sum() / total, -1.0, 1.0)) if total > 0 else 0.0
    return gains


def explainable_share(trials: Sequence[Trial], residuals: Sequence[Vec], seed: int = 0) -> float:
    """Share of the residual's energy that a flexible model of the command's past explains held out, 0 to 1.

    Ridge regression on lagged commands, speeds, play states of six widths, commands low-passed at five time constants,
    and `tanh` of random mixtures of these, by leave-one-trial-out; ridge and whether the random features join are
    chosen for each trial on the others; a trial that it makes worse counts as unexplained. It only tells how much is
    explainable by the command at all.

    Args:
        trials: uniform, at one rate.
        residuals: (T,) each [deg].
        seed: of the random mixtures.

    Raises:
        GapError: if residuals do not fit the trials or are not finite.
        LogError: if a trial is not uniform.
    """
    require_residuals(trials, residuals)
    targets = _folded(residuals)
    own = np.array([float(y @ y) for y in targets])
    energy = float(own.sum())
    if energy <= 0:
        return 0.0
    plain = _folded(past_features(trials))
    size = plain[0].shape[1]
    random = np.random.default_rng(seed)
    mixing = random.standard_normal((size, _RANDOM)) / np.sqrt(size)
    phase = random.uniform(-1.5, 1.5, _RANDOM)

    def mixed(x: Mat) -> Mat:
        return np.concatenate([x, np.tanh(1.5 * x @ mixing + phase)], axis=1)

    missed = np.concatenate([_held_out(plain, targets, _RIDGES), _held_out(plain, targets, _RIDGES, mixed)])
    others = missed.sum(axis=1, keepdims=True) - missed
    chosen = np.argmin(others, axis=0)
    explained = 1 - float(np.minimum(missed[chosen, np.arange(len(targets))], own).sum()) / energy
    return float(np.clip(explained, 0.0, 1.0))


def locked_part(trials: Sequence[Trial], residuals: Sequence[Vec]) -> list[Vec]:
    """What the plain features of the command's past explain of residuals (T,), one ridge fit over all trials."""
    rows = [_with_one(x) for x in past_features(trials)]
    gram = np.sum([x.T @ x for x in rows], axis=0)
    product = np.sum([x.T @ e for x, e in zip(rows, residuals, strict=True)], axis=0)
    ridge = _RIDGE * float(np.trace(gram)) / len(gram) * np.eye(len(gram))
    weights = np.linalg.solve(gram + ridge, product)
    return [x @ weights for x in rows]


def past_features(trials: Sequence[Trial]) -> list[Mat]:
    """Command, speeds, lagged and low-passed commands and plays (T, F) of each trial, of unit variance over all."""
    low = min(float(trial.command.min()) for trial in trials)
    span = max(float(trial.command.max()) for trial in trials) - low or 1.0
    rows = [_past((trial.command - low) / span, trial.dt) for trial in trials]
    samples = sum(len(x) for x in rows)
    mean = np.sum([x.sum(axis=0) for x in rows], axis=0) / samples
    variance = np.sum([((x - mean) ** 2).sum(axis=0) for x in rows], axis=0) / samples
    scale = np.maximum(np.sqrt(variance), 1e-9)
    return [(x - mean) / scale for x in rows]


def _folded(signals: Sequence[Mat]) -> list[Mat]:
    """Signals (T, ...) of every trial; of a single trial its parts."""
    if len(signals) > 1:
        return list(signals)
    edges = np.linspace(0, len(signals[0]), _PARTS + 1).astype(np.intp)
    return np.split(signals[0], edges[1:-1])


def _held_out(
    rows: Sequence[Mat], targets: Sequence[Vec], ridges: Sequence[float], more: Callable[[Mat], Mat] | None = None
) -> Mat:
    """Squared errors (ridges, folds) on each fold of a ridge fit with intercept to the others.

    `more` adds features that are made of these, for one fold at a time: of all folds they would be gigabytes.
    """
    folds = range(len(rows))

    def features(k: int) -> Mat:
        return _with_one(rows[k] if more is None else more(rows[k]))

    moments = [_moments(features(k), targets[k]) for k in folds]
    gram, product = (np.sum([m[j] for m in moments], axis=0) for j in (0, 1))
    missed = np.empty((len(ridges), len(rows)))
    for k in folds:
        rest = gram - moments[k][0]
        scale, turn = np.linalg.eigh(rest)
        seen = turn.T @ (product - moments[k][1])
        shown = features(k) @ turn
        for j, ridge in enumerate(ridges):
            damped = np.maximum(scale, 0.0) + ridge * float(np.mean(np.maximum(scale, 0.0)))
            missed[j, k] = float(np.sum((targets[k] - shown @ (seen / damped)) ** 2))
    return missed


def _moments(x: Mat, y: Vec) -> tuple[Mat, Vec]:
    return x.T @ x, x.T @ y


def _with_one(x: Mat) -> Mat:
    return np.concatenate([np.ones((len(x), 1)), x], axis=1)


def _past(u: Vec, dt: float) -> Mat:
    """Features (T, F) of a command between 0 and 1 and its past."""
    lags = [max(1, round(lag / dt)) for lag in _LAGS_S]
    late = [np.concatenate([np.full(min(k, u.size), u[0]), u[:-k]])[: u.size] for k in lags]
    v = np.gradient(u, dt)
    slow = [u[0] + lfilter([dt / (tau + dt)], [1, -tau / (tau + dt)], u - u[0]) for tau in _AGES_S]
    return np.column_stack([u, u**2, u**3, v, np.abs(v), np.sign(v), *late, *slow, *_plays(u).T])


def _plays(u: Vec) -> Mat:
    """Play states (T, widths) of half width r: p = max(u - r, min(u + r, p))."""
    half = 0.5 * np.array(_WIDTHS)
    lower, upper = u[:, None] - half, u[:, None] + half
    p = np.empty_like(lower)
    now = np.full(half.size, u[0])
    for k in range(u.size):
        now = np.minimum(np.maximum(now, lower[k]), upper[k])
        p[k] = now
    return p


class _View:
    """Features of one trial's command, a set per memory."""

    def __init__(self, trial: Trial, loop_width: float) -> None:
        self.parts = command_segments(trial)
        self.width = max(loop_width, 1e-9)
        self.u, self.dt = trial.command, trial.dt
        self.span = max(float(np.ptp(self.u)), 1e-9)

    def features(self, name: str, clock_s: float) -> Mat:
        """Features (T, F) of the memory of that name."""
        n = self.u.size
        if name == "speed":
            v = np.gradient(self.u, self.dt) / self.span
            bent = v / (np.abs(v) + _TYPICAL)  # bounded: a step must not lead the fit
            return np.column_stack([bent, np.abs(bent), np.sign(v) * (np.abs(v) > 1e-3), bent**2])
        if name == "clock":
            t = np.arange(n, dtype=np.float64) * self.dt
            return np.column_stack([t, clock_s + t]) / 60.0
        direction = last_direction(self.parts)
        if name == "hold_age":
            held = self.parts.labels == Motion.HOLD
            return self._fading(_since(~held) * self.dt, direction * held)
        turned = np.zeros(n, dtype=np.bool_)
        turned[self.parts.reversals] = True
        if name == "since_reversal":
            return self._fading(_since(turned) * self.dt, direction)
        travelled = np.cumsum(np.abs(np.diff(self.u, prepend=self.u[0])))
        since = travelled - travelled[np.arange(n) - _since(turned)]
        near = [direction * np.exp(-since / (k * self.width)) for k in (0.5, 1.0, 2.0)]
        return np.column_stack([*near, travelled / self.span / 10.0])

    def _fading(self, age: NDArray[Any], weight: Vec) -> Mat:
        return np.column_stack([weight, *(weight * np.exp(-age / tau) for tau in _AGES_S)])


def last_direction(parts: Segments) -> Vec:
    """+1 or -1 by the last move at or before each sample, (T,); 0 before the first."""
    at = np.where(parts.labels != Motion.HOLD, np.arange(parts.labels.size), -1)
    last = np.maximum.accumulate(at)
    return np.where(last >= 0, parts.labels[last], 0).astype(np.float64)


def _since(events: NDArray[np.bool_]) -> Index:
    """Samples since the last event, or since the start, (T,)."""
    k = np.arange(events.size)
    return k - np.maximum.accumulate(np.where(events, k, 0))

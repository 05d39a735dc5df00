"""Features of a command's past, for linear models of the angle or of a residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from hystmpc.trials.segments import Motion, Segments
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Mask, Mat, Vec

from .motion_type import command_segments

MEMORIES = ("speed", "since_reversal", "hold_age", "travel", "clock")

_AGES_S = (0.1, 0.4, 1.5, 6.0, 25.0)
_LAGS_S = (0.04, 0.08, 0.16, 0.32, 0.64, 1.28)
_WIDTHS = (0.02, 0.05, 0.1, 0.18, 0.3, 0.45)  # of the command's range
_TYPICAL_SPEED = 0.3  # of the command in ranges [1/s]


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


def memory_features(trial: Trial, loop_width: float, clock_s: float) -> dict[str, Mat]:
    """Features (T, F) of one trial's command for each of `MEMORIES`.

    Args:
        trial: uniform.
        loop_width: width of the hysteresis loop along the command [cmd].
        clock_s: time recorded before the trial [s].
    """
    parts, u, dt = command_segments(trial), trial.command, trial.dt
    span, width = max(float(np.ptp(u)), 1e-9), max(loop_width, 1e-9)
    v = np.gradient(u, dt) / span
    bounded = v / (np.abs(v) + _TYPICAL_SPEED)  # a step must not dominate the fit
    direction, held = _last_direction(parts), parts.labels == Motion.HOLD
    turned = np.zeros(u.size, dtype=np.bool_)
    turned[parts.reversals] = True
    travelled = np.cumsum(np.abs(np.diff(u, prepend=u[0])))
    since = travelled - travelled[np.arange(u.size) - _samples_since(turned)]
    t = np.arange(u.size, dtype=np.float64) * dt
    columns = (
        [bounded, np.abs(bounded), np.sign(v) * (np.abs(v) > 1e-3), bounded**2],
        _decaying(_samples_since(turned), dt, direction),
        _decaying(_samples_since(~held), dt, direction * held),
        [*(direction * np.exp(-since / (k * width)) for k in (0.5, 1.0, 2.0)), travelled / span / 10.0],
        [t / 60.0, (clock_s + t) / 60.0],
    )
    return {name: np.column_stack(own) for name, own in zip(MEMORIES, columns, strict=True)}


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


def _decaying(age: Index, dt: float, weight: Vec) -> list[Vec]:
    """A weight (T,), alone and times exponentials of an age in samples (T,)."""
    return [weight, *(weight * np.exp(-(age * dt) / tau) for tau in _AGES_S)]


def _last_direction(parts: Segments) -> Vec:
    """+1 or -1 by the last move at or before each sample (T,); 0 before the first."""
    last = np.maximum.accumulate(np.where(parts.labels != Motion.HOLD, np.arange(parts.labels.size), -1))
    return np.where(last >= 0, parts.labels[last], 0).astype(np.float64)


def _samples_since(events: Mask) -> Index:
    """Samples since the last event, or since the start (T,)."""
    k = np.arange(events.size)
    return k - np.maximum.accumulate(np.where(events, k, 0))

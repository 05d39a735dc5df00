"""Trials on a uniform time grid."""

from __future__ import annotations

import math

import numpy as np

from .errors import ConfigError, LogError
from .trial import Trial

MAX_GAP_S = 0.2
"""Longest gap that interpolation may bridge [s]: on a 0.5 Hz sine of 60 deg it errs by up to 1.5 deg."""

GAP_INTERVALS = 3.0
"""A gap is also at least this many median sample intervals, so that slow logs are not all gaps."""

_RATE_MARGIN = 1.5  # a grid this much finer than the log itself would only invent samples


def gap_limit_s(median_interval_s: float, max_gap_s: float = MAX_GAP_S) -> float:
    """Sample interval above which a log has a gap [s]."""
    return max(max_gap_s, GAP_INTERVALS * median_interval_s)


def resample(trial: Trial, rate_hz: float, max_gap_s: float = MAX_GAP_S) -> Trial:
    """Interpolate linearly onto t[0] + k / rate_hz, up to the last sample; channels come along.

    There is no anti-aliasing filter: a command that a controller sent is not band-limited, and a filter would shift
    its turning points.

    Args:
        trial: recorded at any, also varying, rate.
        rate_hz: rate of the result [Hz].
        max_gap_s: longest sample interval that is bridged [s].

    Raises:
        ConfigError: if the rate is not a positive number.
        LogError: at a gap, on a rate above 1.5 times the log's own, or if the trial is shorter than one interval.
    """
    if not (math.isfinite(rate_hz) and rate_hz > 0):
        raise ConfigError(f"rate_hz: got {rate_hz}, expected a positive number")
    own_hz = 1.0 / trial.dt
    if rate_hz > _RATE_MARGIN * own_hz:
        raise LogError(
            f"{trial.source}: got rate_hz {rate_hz:g}, expected at most {_RATE_MARGIN * own_hz:.4g} "
            f"({_RATE_MARGIN:g} times the log's own median rate of {own_hz:.4g} Hz)"
        )
    intervals = np.diff(trial.t)
    limit = gap_limit_s(trial.dt, max_gap_s)
    widest = int(np.argmax(intervals))
    if intervals[widest] > limit:
        raise LogError(
            f"{trial.source}: gap of {intervals[widest]:.3g} s from {trial.t[widest]:.6g} s "
            f"(samples {widest} and {widest + 1}), expected at most {limit:.3g} s; cut the log there"
        )
    count = math.floor(trial.duration_s * rate_hz + 1e-6) + 1
    t = trial.t[0] + np.arange(count) / rate_hz
    return Trial(
        t,
        np.interp(t, trial.t, trial.command),
        np.interp(t, trial.t, trial.angle),
        {name: np.interp(t, trial.t, values) for name, values in trial.channels.items()},
        trial.units,
        trial.source,
    )


def require_uniform(trial: Trial) -> float:
    """Sample interval [s] of a trial on a uniform grid.

    Raises:
        LogError: if an interval differs from the median by more than 1 %.
    """
    intervals = np.diff(trial.t)
    off = int(np.argmax(np.abs(intervals - trial.dt)))
    if abs(intervals[off] - trial.dt) > 0.01 * trial.dt:
        raise LogError(
            f"{trial.source}: sample interval {intervals[off]:.6g} s at {trial.t[off]:.6g} s, "
            f"expected {trial.dt:.6g} s throughout; resample the trial first"
        )
    return trial.dt

"""Quality of a log's clock: rate, jitter, gaps, repeated time stamps, repeated measurements."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from .errors import LogError
from .findings import Finding, Severity
from .resample import gap_limit_s
from .trial import Trial
from .types import Vec

_SLOW_INTERVAL_S = 1.0  # no closed loop of this field samples slower: time is then likely in ms
_JITTER_SHARE = 0.1  # of the median interval; more is worth knowing
_STUCK_SHARE = 0.05  # of the range of the command: travel without any change of the angle


def time_findings(t: Vec, command: Vec, angle: Vec, where: Callable[[int], str]) -> Iterator[Finding]:
    """Findings on time stamps [s] that may repeat, run backwards or be missing.

    Args:
        t, command, angle: signals, (T,).
        where: names a sample for the reader.
    """
    kept = np.flatnonzero(np.isfinite(t))
    intervals = np.diff(t[kept])
    forward = intervals[intervals > 0]
    if not forward.size:
        yield Finding(Severity.ERROR, "time base", "time never increases")
        return
    median = float(np.median(forward))
    yield _base(median, float(t[kept[0]]), float(t[kept[-1]]), t.size)
    yield _jitter(forward, median)
    yield _gaps(t, kept, intervals, median, where)
    yield _order(kept, intervals, where)
    yield _stuck(t, command, angle)


def require_seconds(trial: Trial) -> None:
    """Refuse a trial whose time is most likely in milliseconds.

    Raises:
        LogError: if its samples are a second or more apart.
    """
    if trial.dt >= _SLOW_INTERVAL_S:
        raise LogError(f"{trial.source}: {_slow(trial.dt, float(trial.t[0]), float(trial.t[-1]))}")


def _slow(median: float, start: float, stop: float) -> str:
    return (
        f"time_s runs from {start:g} to {stop:g}, sampling rate {1 / median:.3g} Hz, expected more than "
        f"{1 / _SLOW_INTERVAL_S:g} Hz: is it in milliseconds?"
    )


def _base(median: float, start: float, stop: float, count: int) -> Finding:
    if median >= _SLOW_INTERVAL_S:
        return Finding(Severity.ERROR, "time base", _slow(median, start, stop))
    return Finding(Severity.OK, "time base", f"{1 / median:.4g} Hz (median), {stop - start:.4g} s, {count} samples")


def _jitter(forward: Vec, median: float) -> Finding:
    spread = float(np.std(forward))
    severity = Severity.NOTE if spread > _JITTER_SHARE * median else Severity.OK
    return Finding(
        severity,
        "jitter",
        f"sample interval {1e3 * median:.3g} ms (median), standard deviation {1e3 * spread:.2g} ms "
        f"({spread / median:.0%}), longest {1e3 * float(forward.max()):.3g} ms",
    )


def _gaps(t: Vec, kept: NDArray[np.intp], intervals: Vec, median: float, where: Callable[[int], str]) -> Finding:
    limit = gap_limit_s(median)
    gaps = np.flatnonzero(intervals > limit)
    if not gaps.size:
        return Finding(Severity.OK, "gaps", f"none longer than {limit:.3g} s")
    k = int(gaps[np.argmax(intervals[gaps])])
    return Finding(
        Severity.ERROR,
        "gaps",
        f"{gaps.size} longer than {limit:.3g} s, the longest {intervals[k]:.3g} s from {t[kept[k]]:.6g} s "
        f"({where(int(kept[k]))}); cut the log there",
    )


def _order(kept: NDArray[np.intp], intervals: Vec, where: Callable[[int], str]) -> Finding:
    same, back = np.flatnonzero(intervals == 0), np.flatnonzero(intervals < 0)
    parts = [
        f"{found.size} time stamps {what}, first at {where(int(kept[found[0] + 1]))}"
        for found, what in ((same, "repeat the one before"), (back, "run backwards"))
        if found.size
    ]
    if parts:
        return Finding(Severity.ERROR, "duplicates", "; ".join(parts))
    return Finding(Severity.OK, "duplicates", "time increases from sample to sample")


def _stuck(t: Vec, command: Vec, angle: Vec) -> Finding:
    """Stretches of one and the same angle; of these, the one over which the command travels farthest."""
    topic = "stuck samples"
    starts = np.concatenate(([0], np.flatnonzero(angle[1:] != angle[:-1]) + 1))
    share = 1 - (starts.size - 1) / (angle.size - 1)
    text = f"{share:.0%} of the angles equal the one before"
    known = np.where(np.isfinite(command), command, np.nan)
    travel = np.nan_to_num(np.fmax.reduceat(known, starts) - np.fmin.reduceat(known, starts))
    span = float(np.nan_to_num(np.fmax.reduce(known) - np.fmin.reduce(known)))
    farthest = int(np.argmax(travel))
    if travel[farthest] <= _STUCK_SHARE * span:
        return Finding(Severity.OK, topic, text)
    start, stop = int(starts[farthest]), int(np.append(starts, angle.size)[farthest + 1]) - 1
    return Finding(
        Severity.NOTE,
        topic,
        f"{text}; from {t[start]:.6g} to {t[stop]:.6g} s it stays the same while the command travels "
        f"{travel[farthest]:.3g}: dead zone or stuck sensor",
    )

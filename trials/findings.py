"""Findings of a quality check, and the findings on time stamps: rate, unit, jitter, gaps, repeats, stuck samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .brief import in_brief
from .clocks import (
    SECONDS,
    SLOWEST_HZ,
    UNUSUAL_HZ,
    CounterWrap,
    Interval,
    SuspectedUnit,
    counter_wrap,
    interval_of,
    suspected_unit,
    without_wraps,
)
from .errors import LogError
from .segments import DEFAULT_RULE, turning_points
from .trial import Trial, clock_advice, gap_limit_s, parts_at_gaps
from .types import Vec


class Severity(StrEnum):
    """Severity of a finding, in increasing order."""

    OK = "ok"
    NOTE = "note"  # information
    WARNING = "warning"  # the log can be used, results will suffer
    ERROR = "error"  # readers or identifications will refuse the log


@dataclass(frozen=True)
class Finding:
    """One line of a quality check.

    Attributes:
        topic: subject of the check, such as `jitter` or `units`.
    """

    severity: Severity
    topic: str
    message: str


@dataclass(frozen=True)
class CheckReport:
    """All findings on one log, in the order of the checks."""

    source: str
    layout: str
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        return in_brief(self, f"{self.source}: {len(self.findings)} findings, worst {self.worst}")

    @property
    def worst(self) -> Severity:
        """Greatest severity among the findings."""
        order = list(Severity)
        return max((f.severity for f in self.findings), key=order.index, default=Severity.OK)

    def of(self, topic: str) -> tuple[Finding, ...]:
        """The findings on one topic."""
        return tuple(f for f in self.findings if f.topic == topic)

    def __str__(self) -> str:
        head = f"{self.source} ({self.layout})" if self.layout else self.source
        return "\n".join([head, *(f"{f.severity:8} {f.topic}: {f.message}" for f in self.findings)])

    def _repr_html_(self) -> str:
        from .report import Report, Table  # matplotlib takes longer to import than a log to check

        rows = [(str(f.severity), f.topic, f.message) for f in self.findings]
        return Report(self.source, (Table(("", "topic", "finding"), rows),), self.layout).fragment()


_JITTER_SHARE = 0.1  # of the median interval; more is reported
_STUCK_SHARE = 0.05  # of the range of the command: travel without any change of the angle
_COARSE_SHARE = 0.1  # of the stamps that repeat: their clock is coarse, not out of order
_STEP_SHARE = 0.005  # of the range of the angle: a finer step of a sensor is irrelevant
_NAMED = 6  # greatest number of listed parts of a log
_STOOD = 0.02  # of the range of the command: it did not move over a gap


@dataclass(frozen=True, eq=False)
class LogClock:
    """Time stamps of a log, with the wrap of their counter and their unit."""

    t: Vec  # stamps [s] as read, after removal of the wraps of a counter, (T,)
    wrap: CounterWrap | None  # of the counter, in `unit`
    unit: str  # unit in the log, a key of `SECONDS`
    interval: Interval | None
    suspicion: SuspectedUnit | None

    @property
    def factor(self) -> float:
        """Factor from the stamps as read to seconds."""
        return 1.0 if self.suspicion is None else SECONDS[self.suspicion.units[0]]


def clock_of(t: Vec, command: Vec, unit: str = "s") -> LogClock:
    """Analyse time stamps (T,) [s] that were read in `unit`; the command (T,) shows the pace of the device."""
    wrap = counter_wrap(t / SECONDS[unit])
    whole = t if wrap is None else without_wraps(t, wrap.modulus * SECONDS[unit])
    known = command[np.isfinite(command)]
    turns = turning_points(known, DEFAULT_RULE.reversal * float(np.ptp(known)))[1].size if known.size else 0
    # A unit other than seconds in a mapping is accepted without a check.
    suspicion = suspected_unit(whole, turns) if unit == "s" else suspected_unit(whole)
    return LogClock(whole, wrap, unit, interval_of(whole), suspicion)


def sampled_time(clock: LogClock) -> Vec:
    """Time (T,) [s] in the likely unit, evenly spaced if a coarse clock repeats its stamps."""
    steps = np.diff(clock.t[np.isfinite(clock.t)])
    coarse = steps.size and np.all(steps >= 0) and np.mean(steps == 0) > _COARSE_SHARE
    if coarse and clock.interval is not None and clock.interval.middle > 0:
        return np.arange(clock.t.size, dtype=np.float64) * (clock.interval.middle * clock.factor)
    return clock.t * clock.factor


def time_findings(clock: LogClock, command: Vec, angle: Vec, where: Callable[[int], str]) -> Iterator[Finding]:
    """Findings on time stamps [s] that may repeat, run backwards or be missing."""
    t = clock.t
    kept = np.flatnonzero(np.isfinite(t))
    intervals = np.diff(t[kept])
    forward = intervals[intervals > 0]
    if not forward.size or clock.interval is None:
        yield Finding(Severity.ERROR, "time base", "time never increases")
        return
    median = float(np.median(forward))
    yield _base(clock, float(forward.sum()))
    yield _jitter(forward, median, clock)
    yield _gaps(t, kept, intervals, median, where, command)
    yield _order(clock, kept, intervals, where)
    yield _stuck(t, command, angle)


def _base(clock: LogClock, duration: float) -> Finding:
    assert clock.interval is not None
    t, rate = clock.t, 1 / max(clock.interval.middle, 1e-300)
    if clock.suspicion is None:
        steps = np.diff(t[np.isfinite(t)])
        even = bool(np.all(steps > 0))
        rate = 1 / float(np.median(steps)) if even else clock.interval.rate_hz
        text = (
            f"{rate:.4g} Hz ({'median' if even else 'from the count of samples'}), {duration:.4g} s, {t.size} samples"
        )
        return Finding(Severity.OK, "time base", text)
    text = f"time_s runs from {np.nanmin(t):.15g} to {np.nanmax(t):.15g}, sampling rate {rate:.3g} Hz"
    if not clock.suspicion.certain:
        return Finding(Severity.WARNING, "time base", f"{text}, which is unusual: {clock.suspicion.text}")
    limit = f"expected {SLOWEST_HZ:g} Hz to {UNUSUAL_HZ / 1e3:g} kHz"
    return Finding(Severity.ERROR, "time base", f"{text}, {limit}: {clock.suspicion.text}")


def _jitter(forward: Vec, median: float, clock: LogClock) -> Finding:
    repeated = clock.t.size - 1 - forward.size
    if clock.interval is not None and repeated > _COARSE_SHARE * clock.t.size:
        each = median / clock.interval.middle
        text = f"the stamps come in steps of {median:.3g} s, about {each:.3g} samples in each: jitter cannot be told"
        return Finding(Severity.NOTE, "jitter", text)
    spread = float(np.std(forward))
    text = (
        f"sample interval {1e3 * median:.3g} ms (median), standard deviation {1e3 * spread:.2g} ms "
        f"({spread / median:.0%}), longest {1e3 * float(forward.max()):.3g} ms"
    )
    return Finding(Severity.NOTE if spread > _JITTER_SHARE * median else Severity.OK, "jitter", text)


def _gaps(
    t: Vec, kept: NDArray[np.intp], intervals: Vec, median: float, where: Callable[[int], str], command: Vec
) -> Finding:
    limit = gap_limit_s(median)
    gaps = np.flatnonzero(intervals > limit)
    if not gaps.size:
        return Finding(Severity.OK, "gaps", f"none longer than {limit:.3g} s")
    k = int(gaps[np.argmax(intervals[gaps])])
    text = f"{gaps.size} longer than {limit:.3g} s"
    if (intervals > 0).all():
        even = Trial(t[kept], t[kept], t[kept])
        with suppress(LogError):
            return Finding(Severity.NOTE, "gaps", f"{text}; {gaps_text(even, parts_at_gaps(even))}")
    advice = "cut the log there"
    moved = np.abs(command[kept[gaps + 1]] - command[kept[gaps]])
    if gaps.size > 1 and np.all(moved <= _STOOD * np.nanmax(command) - _STOOD * np.nanmin(command)):
        advice = (
            "over all of them the command stands: it was recorded on change only; record at a fixed rate, "
            "rests too, or repeat the last row of each"
        )
    longest = f"the longest {intervals[k]:.3g} s from {t[kept[k]]:.6g} s ({where(int(kept[k]))})"
    return Finding(Severity.ERROR, "gaps", f"{text}, {longest}; {advice}")


def gaps_text(trial: Trial, parts: Sequence[Trial]) -> str:
    """Text on the parts of a trial between its gaps and the samples left out; empty without a gap."""
    left = len(trial) - sum(map(len, parts))
    if not left and len(parts) == 1:
        return ""
    spans = [f"{part.t[0]:.6g} to {part.t[-1]:.6g} s" for part in parts]
    if len(spans) > _NAMED:
        spans = [*spans[: _NAMED - 1], f"... ({len(parts)} in all)"]
    out = f"{left} samples beside a gap are left out; " if left else ""
    return f"{out}{'used' if len(parts) == 1 else f'cut into {len(parts)} trials'}: {', '.join(spans)}"


def _order(clock: LogClock, kept: NDArray[np.intp], intervals: Vec, where: Callable[[int], str]) -> Finding:
    topic = "duplicates"
    if clock.wrap is not None:
        keys = [f"time_wraps_at: {clock.wrap.modulus:.16g}"]
        unit = clock.unit if clock.suspicion is None else clock.suspicion.units[0]
        keys += [f"time_unit: {unit}"] if unit != "s" else []
        text = (
            f"time runs backwards {len(clock.wrap.samples)} times, first at {where(clock.wrap.samples[0])}: "
            f"{clock.wrap.text}; a mapping file with `{', '.join(keys)}` reads it"
        )
        return Finding(Severity.ERROR, topic, text)
    same, back = np.flatnonzero(intervals == 0), np.flatnonzero(intervals < 0)
    parts = [
        f"{samples.size} time stamps {what}, first at {where(int(kept[samples[0] + 1]))}"
        for samples, what in ((same, "repeat the one before"), (back, "run backwards"))
        if samples.size
    ]
    if parts:
        return Finding(Severity.ERROR, topic, "; ".join(parts) + clock_advice(clock.t[kept] * clock.factor))
    return Finding(Severity.OK, topic, "time increases from sample to sample")


def _stuck(t: Vec, command: Vec, angle: Vec) -> Finding:
    """Finding on stuck samples: the stretch of constant angle with the largest motion of the command."""
    topic = "stuck samples"
    starts = np.concatenate(([0], np.flatnonzero(angle[1:] != angle[:-1]) + 1))
    share = 1 - (starts.size - 1) / (angle.size - 1)
    text = f"{share:.0%} of the angles equal the one before"
    known = np.where(np.isfinite(command), command, np.nan)
    travel = np.nan_to_num(np.fmax.reduceat(known, starts) - np.fmin.reduceat(known, starts))
    span = float(np.nan_to_num(np.fmax.reduce(known) - np.fmin.reduce(known)))
    farthest = int(np.argmax(travel))
    step, gain = _sensor_step(angle), _gain(command, angle)
    if step:
        text += f": its sensor reads in steps of {step:.3g}"
    if travel[farthest] <= max(_STUCK_SHARE * span, 2 * step / gain if gain > 0 else 0.0):
        return Finding(Severity.OK, topic, text)
    start, stop = int(starts[farthest]), int(np.append(starts, angle.size)[farthest + 1]) - 1
    text += f"; from {t[start]:.6g} to {t[stop]:.6g} s it stays the same while the command travels "
    text += f"{travel[farthest]:.3g}: {'a play, a ' if step else ''}dead zone or stuck sensor"
    return Finding(Severity.NOTE, topic, text)


def _sensor_step(angle: Vec) -> float:
    """Resolution of a sensor, if it is a noticeable share of the range; otherwise 0."""
    levels = np.unique(angle[np.isfinite(angle)])
    if levels.size < 3 or levels.size > 0.5 * angle.size:
        return 0.0
    span = float(levels[-1] - levels[0])
    steps = np.diff(levels)
    step = float(steps[steps > 1e-9 * span].min())
    whole = (levels - levels[0]) / step
    even = bool(np.all(np.abs(whole - np.rint(whole)) < 0.05))
    return step if even and step > _STEP_SHARE * span else 0.0


def _gain(command: Vec, angle: Vec) -> float:
    """Absolute gain: slope of a straight line, angle over command; 0 if it is undefined."""
    known = np.isfinite(command) & np.isfinite(angle)
    if np.count_nonzero(known) < 2:
        return 0.0
    u, y = command[known] - command[known].mean(), angle[known] - angle[known].mean()
    power = float(u @ u)
    return abs(float(u @ y)) / power if power > 0 else 0.0

"""Quality check of a recorded log before anything is identified from it: clock, values, units, sign, motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .brief import in_brief
from .csv_files import Columns, read_columns
from .errors import LogError, in_a_line
from .layouts import CANONICAL, SECONDS, LogMapping, Preset
from .read import Layout, Log, is_table, read_raw, resolve
from .segments import Motion, Segments, segment
from .signals import Raw
from .trial import Trial, clock_advice, even_time, gap_limit_s, parts_at_gaps, resample
from .types import Vec


class Severity(StrEnum):
    """How much a finding matters, least first."""

    OK = "ok"
    NOTE = "note"  # worth knowing
    WARNING = "warning"  # the log can be used, results will suffer
    ERROR = "error"  # readers or identifications will refuse the log


@dataclass(frozen=True)
class Finding:
    """One line of a quality check.

    Attributes:
        severity: how much it matters.
        topic: what was looked at, such as `jitter` or `units`.
        message: what was found, with numbers and units.
    """

    severity: Severity
    topic: str
    message: str


@dataclass(frozen=True)
class CheckReport:
    """All findings on one log, in the order in which they were looked for.

    Attributes:
        source: path of the log.
        preset: layout it was read with, empty for a trial from memory.
        findings: at least one per topic.
    """

    source: str
    preset: str
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        return in_brief(self, f"{self.source}: {len(self.findings)} findings, worst {self.worst}")

    @property
    def worst(self) -> Severity:
        """The greatest severity among the findings."""
        order = list(Severity)
        return max((f.severity for f in self.findings), key=order.index, default=Severity.OK)

    def of(self, topic: str) -> tuple[Finding, ...]:
        """The findings on one topic."""
        return tuple(f for f in self.findings if f.topic == topic)

    def __str__(self) -> str:
        head = f"{self.source} ({self.preset})" if self.preset else self.source
        return "\n".join([head, *(f"{f.severity:8} {f.topic}: {f.message}" for f in self.findings)])

    def _repr_html_(self) -> str:
        from .report import Report, Table  # matplotlib takes longer to import than a log to check

        rows = [(str(f.severity), f.topic, f.message) for f in self.findings]
        return Report(self.source, (Table(("", "topic", "finding"), rows),), self.preset).fragment()


@in_a_line
def check(log: Log, preset: Layout = "auto", sampled_hz: float | None = None) -> CheckReport:
    """Look at time base, jitter, gaps, duplicates, values, units, sign, excitation, segments and first flexure.

    A file or frame is read leniently: what `read_trials` would refuse becomes a finding.

    Args:
        log: a file, a ROS 2 bag, a data frame or a trial.
        preset: its layout, see `read_trials`.
        sampled_hz: rate [Hz] of a log that was sampled evenly, whose time stamps are not looked at.

    Raises:
        LogError: if it cannot be read, or lacks a column or signal.
        ConfigError: on an unknown preset or a wrong mapping file.
    """
    if isinstance(log, Trial):
        log = log if sampled_hz is None else replace(log, t=even_time(len(log), sampled_hz))
        return _report(log, "", CANONICAL, "sample {}".format)
    layout = resolve(preset)
    if not is_table(log) or isinstance(layout, LogMapping):
        raw = read_raw(log, layout, sampled_hz)
        return _report(raw, raw.preset, CANONICAL, "sample {}".format, raw.note)
    columns = read_columns(log, layout, sampled_hz)
    return _report(columns, columns.preset.name, columns.preset, lambda k: f"row {columns.row(k)}")


def _report(
    log: Trial | Raw | Columns, name: str, layout: Preset, where: Callable[[int], str], note: str = ""
) -> CheckReport:
    """All findings; those on the motion are made on the samples that are finite and in order of time."""
    found = [Finding(Severity.NOTE, "file", note)] if note else []
    found += _value_findings(log, where)
    found += time_findings(log.t, log.command, log.angle, where)
    rows = np.column_stack((log.t, log.command, log.angle))
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[np.diff(np.maximum.accumulate(rows[:, 0]), prepend=-np.inf) > 0]
    if len(rows) < LEAST_SAMPLES:
        found.append(
            Finding(Severity.ERROR, "length", f"{len(rows)} usable samples, expected at least {LEAST_SAMPLES}")
        )
    if len(rows) > 1:
        t, command, angle = rows.T
        found += motion_findings(Trial(t, command, angle, units=log.units, source=log.source), layout)
    return CheckReport(log.source, name, tuple(found))


def _value_findings(log: Trial | Raw | Columns, where: Callable[[int], str]) -> Iterator[Finding]:
    """Cells without a finite number, per signal."""
    clean = True
    main = {"time": log.t, "command": log.command, "angle": log.angle}
    for name, values in {**main, **log.channels}.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            clean = False
            severity = Severity.ERROR if name in main else Severity.NOTE
            message = f"{name}: {bad.size} of {values.size} not finite, first at {where(int(bad[0]))}"
            yield Finding(severity, "values", message)
    if clean:
        yield Finding(Severity.OK, "values", f"{log.t.size} samples, all finite")


LEAST_SAMPLES = 50
"""Samples of a trial from which a model can be identified."""

_SLOW_INTERVAL_S = 1.0  # no closed loop of this field samples slower: time is then likely in ms
_FINE = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
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
    yield _order(t, kept, intervals, where)
    yield _stuck(t, command, angle)


def require_seconds(trial: Trial) -> None:
    """Refuse a trial whose time is most likely in milliseconds.

    Raises:
        LogError: if its samples are a second or more apart.
    """
    if trial.dt >= _SLOW_INTERVAL_S:
        raise LogError(f"{trial.source}: {_slow(trial.dt, float(trial.t[0]), float(trial.t[-1]))}")


def gaps_said(trial: Trial, parts: Sequence[Trial]) -> str:
    """What is made of a trial with gaps, in words: what is left out, and what is used; empty without a gap."""
    left = len(trial) - sum(map(len, parts))
    if not left and len(parts) == 1:
        return ""
    spans = ", ".join(f"{part.t[0]:.6g} to {part.t[-1]:.6g} s" for part in parts)
    out = f"{left} samples beside a gap are left out; " if left else ""
    return f"{out}{'used' if len(parts) == 1 else f'cut into {len(parts)} trials'}: {spans}"


def _slow(median: float, start: float, stop: float) -> str:
    unit = next((unit for unit in _FINE if median * SECONDS[unit] < _SLOW_INTERVAL_S), "ms")
    return (
        f"time_s runs from {start:.15g} to {stop:.15g}, sampling rate {1 / median:.3g} Hz, expected more than "
        f"{1 / _SLOW_INTERVAL_S:g} Hz: is it in {_FINE[unit]}? A mapping file with `time_unit: {unit}` reads it"
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
    if (intervals > 0).all():
        even, text = Trial(t[kept], t[kept], t[kept]), f"{gaps.size} longer than {limit:.3g} s"
        with suppress(LogError):
            return Finding(Severity.NOTE, "gaps", f"{text}; {gaps_said(even, parts_at_gaps(even))}")
    return Finding(
        Severity.ERROR,
        "gaps",
        f"{gaps.size} longer than {limit:.3g} s, the longest {intervals[k]:.3g} s from {t[kept[k]]:.6g} s "
        f"({where(int(kept[k]))}); cut the log there",
    )


def _order(t: Vec, kept: NDArray[np.intp], intervals: Vec, where: Callable[[int], str]) -> Finding:
    same, back = np.flatnonzero(intervals == 0), np.flatnonzero(intervals < 0)
    parts = [
        f"{found.size} time stamps {what}, first at {where(int(kept[found[0] + 1]))}"
        for found, what in ((same, "repeat the one before"), (back, "run backwards"))
        if found.size
    ]
    if parts:
        return Finding(Severity.ERROR, "duplicates", "; ".join(parts) + clock_advice(t[kept]))
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


_SEGMENT_RATE_HZ = 50.0  # enough for tip motions up to a few Hz
_RETURN_SHARE = 0.05  # of the command's range: nearer to its start counts as back at its start
_SET_SHARE = 0.02  # of the angle's range; about three times the noise of an electromagnetic tracker on a catheter
_FOLLOWS = 0.3  # correlation of angle and command below which the sign cannot be told

# Range of a signal -> what its numbers look like: (from, to, suspicion); between the rows they look right. Only where
# travel in mm or pressure in bar bends a tip by degrees: of any other device nothing is known that could be compared.
_MISTAKEN: dict[str, tuple[tuple[float, float, str], ...]] = {
    "mm": ((0.0, 0.05, "metres"), (200.0, np.inf, "micrometres")),
    "bar": ((0.0, 0.02, "MPa or a valve signal"), (20.0, 5e3, "kPa or psi"), (5e3, np.inf, "Pa")),
    "deg": ((0.0, 3.5, "radians"), (400.0, np.inf, "sensor counts")),
}


_COMMANDS, _ANGLES, _ANY = (-100.0, 100.0), (-200.0, 200.0), (-np.inf, np.inf)  # plausible values: mm or bar, deg


def motion_findings(trial: Trial, preset: Preset) -> Iterator[Finding]:
    """Findings on a trial whose values are finite and in order."""
    span = float(np.ptp(trial.command))
    bends = trial.units.angle == "deg" and trial.units.command in ("mm", "bar")
    ranges = (preset.command_range or _COMMANDS, preset.angle_range or _ANGLES) if bends else (_ANY, _ANY)
    yield _units("command", trial.command, trial.units.command, ranges[0], bends)
    yield _units("angle", trial.angle, trial.units.angle, ranges[1], bends)
    if span == 0:
        text = f"the command is {trial.command[0]:g} {trial.units.command} throughout: nothing can be identified"
        yield Finding(Severity.ERROR, "excitation", text)
        return
    if np.ptp(trial.angle) == 0:
        text = f"the angle is {trial.angle[0]:g} {trial.units.angle} throughout: nothing can be identified"
        yield Finding(Severity.ERROR, "excitation", text)
        return
    yield _sign(trial)
    try:
        longest = max(parts_at_gaps(trial), key=len)
        even = resample(longest, min(_SEGMENT_RATE_HZ, 1 / longest.dt))
    except LogError as error:
        yield Finding(Severity.ERROR, "segments", f"not looked for: {str(error).removeprefix(f'{trial.source}: ')}")
        return
    parts = segment(even)
    yield _excitation(even, parts)
    yield _segments(even, parts)
    yield _first_flexure(even, parts)


def _units(name: str, values: Vec, unit: str, plausible: tuple[float, float], bends: bool) -> Finding:
    low, high, topic = float(values.min()), float(values.max()), f"units of {name}"
    text = f"{low:.4g} to {high:.4g} {unit}"
    for least, most, suspicion in _MISTAKEN.get(unit, ()) if bends else ():
        # 30.0 to 30.1 is no angle in radians: a signal in a larger unit has small values, not a small range alone.
        if least < high - low <= most and max(-low, high) <= 2 * most:
            return Finding(Severity.WARNING, topic, f"{text}: looks like {suspicion}, expected {unit}")
    if low < plausible[0] or high > plausible[1]:
        return Finding(
            Severity.WARNING, topic, f"{text}: expected {plausible[0]:g} to {plausible[1]:g}; offset or another unit?"
        )
    return Finding(Severity.OK, topic, text)


def _sign(trial: Trial) -> Finding:
    """Does the angle rise with the command, and by how much."""
    u, y = trial.command - trial.command.mean(), trial.angle - trial.angle.mean()
    power = float(np.sqrt((u @ u) * (y @ y)))
    together = float(u @ y) / power if power > 0 else 0.0
    text = f"{float(u @ y / (u @ u)):.3g} {trial.units.angle} per {trial.units.command} (correlation {together:.2f})"
    if abs(together) < _FOLLOWS:
        return Finding(Severity.WARNING, "sign", f"the angle hardly follows the command: {text}")
    if together < 0:
        return Finding(Severity.WARNING, "sign", f"the angle falls as the command rises: {text}; flip one of them")
    return Finding(Severity.OK, "sign", f"the angle rises with the command: {text}")


def _excitation(trial: Trial, parts: Segments) -> Finding:
    count = parts.reversals.size
    speed = np.abs(np.diff(trial.command)) / trial.dt
    text = f"{count} reversals of the command, fastest {float(speed.max()):.3g} {trial.units.command}/s"
    if not count:
        return Finding(Severity.WARNING, "excitation", f"{text}: hysteresis shows only after a reversal")
    return Finding(Severity.OK, "excitation", text)


def _segments(trial: Trial, parts: Segments) -> Finding:
    texts = []
    for motion in (Motion.LOADING, Motion.UNLOADING, Motion.HOLD):
        seconds = float(np.count_nonzero(parts.labels == motion)) * trial.dt
        texts.append(f"{len(parts.runs(motion))} {motion.name.lower()} ({seconds:.3g} s)")
    return Finding(Severity.OK, "segments", ", ".join(texts))


def _first_flexure(trial: Trial, parts: Segments) -> Finding:
    """Compare the angle before the first flexure with the one when the command is back."""
    topic, unit, out, u, y = "first flexure", trial.units.command, trial.units.angle, trial.command, trial.angle
    if not parts.reversals.size:
        return Finding(Severity.NOTE, topic, "the command never turns back, so a set cannot be told")
    top = int(parts.reversals[0])
    low = int(parts.reversals[1]) if parts.reversals.size > 1 else len(trial) - 1
    opening = f"ends at {trial.t[top]:.4g} s, {y[top]:.4g} {out} at {u[top]:.3g} {unit}"
    if abs(u[low] - u[0]) > _RETURN_SHARE * float(np.ptp(u)):
        way_up = float(y[int(np.argmin(np.abs(u[: top + 1] - u[low])))])
        return Finding(
            Severity.NOTE,
            topic,
            f"{opening}; the command does not come back to its start ({u[0]:.3g} {unit}), so a set cannot be told "
            f"from hysteresis: at {u[low]:.3g} {unit} the angle was {way_up:.4g} {out} on the way there and "
            f"{y[low]:.4g} {out} back",
        )
    left = float(y[low] - y[0])
    text = (
        f"{opening}; the angle was {y[0]:.4g} {out} before and is {y[low]:.4g} {out} after it: "
        f"a set of {left:+.2g} {out}"
    )
    if abs(left) > _SET_SHARE * float(np.ptp(y)):
        advice = "; score later motions only (--skip-first-flexure)"
        return Finding(Severity.WARNING, topic, text + advice)
    return Finding(Severity.OK, topic, text)

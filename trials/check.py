"""Quality check of a recorded log before anything is identified from it: clock, values, units, sign, motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .clock_findings import clock_of, sampled_time, time_findings
from .clock_shift import IMPOSSIBLE_S, clock_shift
from .clocks import SLOWEST_HZ, UNUSUAL_HZ, suspected_unit
from .errors import LogError, in_a_line
from .findings import CheckReport as CheckReport
from .findings import Finding as Finding
from .findings import Severity as Severity
from .layouts import ANGLE_UNIT_OF, COMMAND_UNIT_OF, LogMapping, SignalSettings
from .read import AnyLayout, Log, read_unchecked, resolve
from .signal_findings import Conversion, encoding_findings, motion_findings
from .signals import UncheckedLog
from .trial import Trial, even_time
from .types import Vec

LEAST_SAMPLES = 50
"""Samples of a trial from which a model can be identified."""

_MODEL_HZ = 25.0  # at which `fit` runs where nothing else is asked for


@in_a_line
def check(log: Log, layout: AnyLayout = "auto", sampled_hz: float | None = None) -> CheckReport:
    """Check a log: time base, jitter, gaps, duplicates, values, units, sign, excitation, segments and first flexure.

    A file or frame is read leniently: what `read_trials` would refuse becomes a finding.

    Args:
        log: a file, a ROS 2 bag, a data frame or a trial.
        layout: its layout, see `read_trials`.
        sampled_hz: rate [Hz] of a log that was sampled evenly, whose time stamps are not looked at.

    Raises:
        LogError: if it cannot be read, or lacks a column or signal.
        ConfigError: on an unknown layout or a wrong mapping file.
    """
    if isinstance(log, Trial):
        t = log.t if sampled_hz is None else even_time(len(log), sampled_hz)
        return _report(UncheckedLog(t, log.command, log.angle, log.channels, log.units, log.source))
    layout = resolve(layout)
    return _report(read_unchecked(log, layout, sampled_hz), layout if sampled_hz is None else None)


def _report(log: UncheckedLog, layout: AnyLayout | None = None) -> CheckReport:
    """All findings; those on the motion are made on samples that are finite, in order of time, and repaired."""
    mapping = layout if isinstance(layout, LogMapping) else None
    findings = [Finding(Severity.NOTE, "file", log.note)] if log.note else []
    findings += _value_findings(log)
    clock = clock_of(log.t, log.command, mapping.time_unit if mapping is not None and mapping.rate_hz is None else "s")
    findings += time_findings(clock, log.command, log.angle, log.where)
    rows = np.column_stack((sampled_time(clock), log.command, log.angle, np.arange(log.t.size)))
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[np.diff(np.maximum.accumulate(rows[:, 0]), prepend=-np.inf) > 0]
    if len(rows) < LEAST_SAMPLES:
        text = f"{len(rows)} usable samples, expected at least {LEAST_SAMPLES}"
        findings.append(Finding(Severity.ERROR, "length", text))
    if len(rows) > 1:
        t, command, angle = rows.T[:3]
        findings += _short(t)
        trial = Trial(t, command, angle, units=log.units, source=log.source)
        encoded, trial = encoding_findings(trial, _conversions(mapping), lambda k: log.where(int(rows[k, 3])))
        findings += [*encoded, *motion_findings(trial, log.ranges)]
    return CheckReport(log.source, log.layout, tuple(findings))


def _conversions(mapping: LogMapping | None) -> tuple[Conversion, Conversion]:
    """Conversions from the numbers in the log to command and angle."""
    if mapping is None:
        return Conversion(), Conversion()
    command, angle = mapping.command, mapping.angle
    return (
        _from(command, COMMAND_UNIT_OF.get(command.unit, ("", 1.0))[1]),
        _from(angle, ANGLE_UNIT_OF.get(angle.unit, ("", 1.0))[1]),
    )


def _from(settings: SignalSettings, factor: float) -> Conversion:
    return Conversion(factor * settings.scale, factor * settings.offset)


def _short(t: Vec) -> Iterator[Finding]:
    """Finding on a log that is too short at the usual rate of models."""
    duration, count = float(t[-1] - t[0]), t.size
    if count >= LEAST_SAMPLES and duration * _MODEL_HZ + 1 < LEAST_SAMPLES:
        rate = min(round(200 / duration, -1), (count - 1) / duration) if duration > 0 else _MODEL_HZ
        text = (
            f"{duration:.3g} s: at {_MODEL_HZ:g} Hz, the usual rate of `fit`, that is {duration * _MODEL_HZ:.0f} "
            f"samples, expected {LEAST_SAMPLES}; `--rate-hz {rate:.3g}` takes more of them"
        )
        yield Finding(Severity.NOTE, "length", text)


def _value_findings(log: UncheckedLog) -> Iterator[Finding]:
    """Cells without a finite number, per signal."""
    clean = True
    main = {"time": log.t, "command": log.command, "angle": log.angle}
    for name, values in {**main, **log.channels}.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            clean = False
            severity = Severity.ERROR if name in main else Severity.NOTE
            message = f"{name}: {bad.size} of {values.size} not finite, first at {log.where(int(bad[0]))}"
            yield Finding(severity, "values", message)
    if clean:
        yield Finding(Severity.OK, "values", f"{log.t.size} samples, all finite")


def require_sound(trial: Trial) -> None:
    """Refuse a trial with wrong signals: another unit of time, codes for missing values, wraps, an output that leads.

    Raises:
        LogError: with what `check` says of it.
    """
    _require_seconds(trial)
    findings, _ = encoding_findings(trial, (Conversion(), Conversion()), "sample {}".format)
    for finding in findings:
        raise LogError(f"{trial.source}: {finding.topic}: {finding.message}")
    shift = clock_shift(trial.t, trial.command, trial.angle)
    if shift is not None and shift.late_s < -IMPOSSIBLE_S:
        raise LogError(f"{trial.source}: {shift.text}")


def _require_seconds(trial: Trial) -> None:
    """Refuse a trial whose time is most likely not in seconds.

    Raises:
        LogError: if its samples are a second or more apart, or come faster than those of any loop of this field.
    """
    unit = suspected_unit(trial.t)
    if unit is not None and unit.certain:
        rate = 1 / trial.dt
        raise LogError(
            f"{trial.source}: time_s runs from {trial.t[0]:.15g} to {trial.t[-1]:.15g}, sampling rate {rate:.3g} Hz, "
            f"expected {SLOWEST_HZ:g} Hz to {UNUSUAL_HZ / 1e3:g} kHz: {unit.text}"
        )

"""Quality check of a recorded log before anything is identified from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .check_motion import motion_findings
from .check_time import time_findings
from .csv_ import read_columns
from .findings import CheckReport, Finding, Severity
from .log_mapping import LogMapping
from .presets import CANONICAL, Preset
from .read import is_text, read_raw, resolve
from .trial import Trial, Units
from .types import Vec


@dataclass(frozen=True, eq=False)
class _Signals:
    """A log to be checked, from a file or from memory; values may be anything."""

    t: Vec
    command: Vec
    angle: Vec
    channels: Mapping[str, Vec]
    units: Units
    preset: Preset
    where: Callable[[int], str]  # how messages name a sample
    note: str = ""  # on the file itself


def check_trial(log: Trial | Path | str, preset: str | Preset = "auto") -> CheckReport:
    """Look at time base, jitter, gaps, duplicates, values, units, sign, excitation, segments and first flexure.

    A file is read leniently: what `read_log` would refuse becomes a finding.

    Args:
        log: a trial, or the path of a log.
        preset: layout of the log, for a path.

    Raises:
        LogError: if the file cannot be read, or lacks a column or signal.
        ConfigError: on an unknown preset or a wrong mapping file.
    """
    if isinstance(log, Trial):
        source, name = log.source, ""
        signals = _Signals(log.t, log.command, log.angle, log.channels, log.units, CANONICAL, lambda k: f"sample {k}")
    else:
        source, name, signals = _read(log, preset)
    return CheckReport(source, name, tuple(_findings(signals, source)))


def _read(log: Path | str, preset: str | Preset) -> tuple[str, str, _Signals]:
    """Path, layout and signals of a file."""
    layout = resolve(preset)
    if not is_text(log) or isinstance(layout, LogMapping):
        raw = read_raw(log, layout)
        channels, where = raw.channels, "sample {}".format
        signals = _Signals(raw.t, raw.command, raw.angle, channels, raw.units, CANONICAL, where, raw.note)
        return raw.source, raw.preset, signals
    columns = read_columns(log, layout)
    signals = _Signals(
        columns.t,
        columns.command,
        columns.angle,
        columns.channels,
        columns.units,
        columns.preset,
        lambda k: f"row {columns.row(k)}",
    )
    return columns.source, columns.preset.name, signals


def _findings(signals: _Signals, source: str) -> Iterator[Finding]:
    """All findings; those on the motion are made on the samples that are finite and in order of time."""
    if signals.note:
        yield Finding(Severity.NOTE, "file", signals.note)
    yield from _value_findings(signals)
    yield from time_findings(signals.t, signals.command, signals.angle, signals.where)
    rows = np.column_stack((signals.t, signals.command, signals.angle))
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[np.diff(np.maximum.accumulate(rows[:, 0]), prepend=-np.inf) > 0]
    if len(rows) < 2:
        yield Finding(Severity.ERROR, "values", f"{len(rows)} usable samples, expected at least 2")
        return
    t, command, angle = rows.T
    yield from motion_findings(Trial(t, command, angle, units=signals.units, source=source), signals.preset)


def _value_findings(signals: _Signals) -> Iterator[Finding]:
    """Cells without a finite number, per signal."""
    clean = True
    main = {"time": signals.t, "command": signals.command, "angle": signals.angle}
    for name, values in {**main, **signals.channels}.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            clean = False
            severity = Severity.ERROR if name in main else Severity.NOTE
            message = f"{name}: {bad.size} of {values.size} not finite, first at {signals.where(int(bad[0]))}"
            yield Finding(severity, "values", message)
    if clean:
        yield Finding(Severity.OK, "values", f"{signals.t.size} samples, all finite")

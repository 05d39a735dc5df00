"""Common part of all log readers: signals with separate time stamps, joined on one time base."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .clock_shift import shift_between
from .clocks import SECONDS, without_wraps
from .encodings import decoded
from .errors import LogError, nearest, shown
from .layouts import (
    ANGLE_UNIT_OF,
    ANGLE_Y,
    CANONICAL,
    COMMAND_UNIT_OF,
    HEADER_TIME,
    LOG_TIME,
    OUTPUT_COLUMN,
    TWO_AXES,
    LogMapping,
    SignalSettings,
    TipSignals,
    few,
)
from .tables import LogTable
from .trial import Trial, Units, clock_advice
from .types import Index, Vec

_MOST_COMPARED = 2000  # greatest number of names compared for the nearest
_STEP = re.compile(r"\.?([^.\[\]]+)|\[([^\[\]]+)\]")


@dataclass(frozen=True, eq=False)
class Series:
    """One logged signal with its time stamps."""

    t: Vec  # time stamps [s], (T,); not-a-number throughout for a log without any
    values: Vec  # as logged, (T,); not-a-number for null
    left_out: NDArray[np.bool_] | None = None  # mask of samples with a missing-value code, (T,); None for none


class SignalLog:
    """An open log of named signals."""

    path: str  # file or folder, for messages
    note: str  # to the user on the file, such as on a truncated one; empty for none
    clock: str = ""  # signal that serves as time if none has a known name; empty for none
    times: frozenset[str] = frozenset()  # signals of dates, converted to seconds since the first

    def names(self) -> tuple[str, ...]:
        """Names of all available signals."""
        raise NotImplementedError

    def series(self, signals: Sequence[str], time: str) -> list[Series]:
        """Return the requested signals; time is `log`, `header`, or the name of a time signal.

        Raises:
            LogError: on a missing signal; names it and the available ones.
        """
        raise NotImplementedError

    def not_read(self) -> LogError | None:
        """Error for a part of the file that cannot be read; None if there is none."""
        return None


@dataclass(frozen=True, eq=False)
class UncheckedLog:
    """Signals (T,) of a log on one time base, before any check of their values.

    Time may repeat, values may be missing.
    """

    t: Vec  # [s]
    command: Vec  # in `units`, as the angle
    angle: Vec
    channels: Mapping[str, Vec]
    units: Units
    source: str
    layout: str = ""
    note: str = ""
    ranges: tuple[tuple[float, float] | None, tuple[float, float] | None] = (None, None)  # plausible; None for any
    cells: Cells | None = None
    inputs: Mapping[str, Vec] = field(default_factory=dict)

    def where(self, sample: int) -> str:
        """Text on the place of a sample for messages: `row 7` of a table, otherwise `sample 5`."""
        return f"sample {sample}" if self.cells is None else f"row {self.cells.locate(sample, 't')[0]}"

    def trial(self) -> Trial:
        """Convert the log to a trial after a check of its values.

        Raises:
            LogError: if values are not finite, time does not increase, or fewer than two samples are left; of a table
                with row, column and cell.
        """
        if self.cells is not None:
            _require_valid(self, self.cells)
        return Trial(self.t, self.command, self.angle, self.channels, self.units, self.source, inputs=self.inputs)


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of a table behind the samples of a log."""

    table: LogTable
    names: Mapping[str, str]  # columns of the log behind `t`, `command` and `angle`
    rows: Index | None = None  # row of the table of each sample; None if every row is a sample

    def locate(self, sample: int, signal: str) -> tuple[int, str]:
        """Row, 1-based as an editor shows it, and text of a sample of `t`, `command` or `angle`."""
        return self.table.locate(sample if self.rows is None else int(self.rows[sample]), self.names[signal])


def _require_valid(log: UncheckedLog, cells: Cells) -> None:
    """Refuse values that are not finite and time that does not increase, by row and column."""
    for name, values in (("t", log.t), ("command", log.command), ("angle", log.angle)):
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            row, cell = cells.locate(int(bad[0]), name)
            more = f" ({bad.size} such cells)" if bad.size > 1 else ""
            got = shown(cell, 60) if cell else "an empty cell"
            raise LogError(
                f"{log.source}, row {row}, column {cells.names[name]!r}: got {got}, expected a finite number{more}"
            )
    late = np.flatnonzero(np.diff(log.t) <= 0)
    if late.size:
        k = int(late[0])
        raise LogError(
            f"{log.source}, {log.where(k + 1)}, column {cells.names['t']!r}: got {log.t[k + 1]:.9g} s after "
            f"{log.t[k]:.9g} s, expected increasing time ({late.size} such rows){clock_advice(log.t)}"
        )


def read_mapped(source: SignalLog, mapping: LogMapping) -> UncheckedLog:
    """Join the signals of a mapping on one time base.

    The base is the time stamps of the angle (or of the command, by the mapping) within the span of the other signal.
    The command keeps its last value until the next, as the device received it; measured signals are interpolated
    linearly; a channel is not-a-number outside its span. Time of the log or the header starts at zero with the first
    message; a time signal keeps its origin.

    Raises:
        LogError: if a signal is missing or empty, command and angle share no time, or a signal and its second one
            have different time stamps.
    """
    wanted = [signal.signal for signal in mapping.signals()]
    timed_by_signal = mapping.rate_hz is None and mapping.time not in (LOG_TIME, HEADER_TIME)
    taken = [signal.second for signal in mapping.signals() if signal.second is not None]
    logged = source.series([*wanted, *taken], mapping.time if mapping.rate_hz is None else LOG_TIME)
    for name, series in zip([*wanted, *taken], logged, strict=True):
        if not series.values.size:
            note = f" ({source.note})" if source.note else ""
            raise LogError(f"{source.path}: signal {name!r} is empty, expected samples{note}")
    owners = [*mapping.signals(), *(signal for signal in mapping.signals() if signal.second is not None)]
    logged = _combined(source.path, mapping, [_decoded(s, owner) for s, owner in zip(logged, owners, strict=True)])
    if mapping.rate_hz is not None:
        logged = [Series(np.arange(s.values.size) / mapping.rate_hz, s.values, s.left_out) for s in logged]
    elif timed_by_signal:
        wrap, unit_s = mapping.time_wraps_at, SECONDS[mapping.time_unit]
        stamps = [s.t if wrap is None else without_wraps(s.t, wrap) for s in logged]
        logged = [Series(t * unit_s, s.values, s.left_out) for t, s in zip(stamps, logged, strict=True)]
    elif np.isnan(logged[0].t).all():
        raise LogError(f"{source.path}: no time stamps of its own, expected `time: SIGNAL` or `rate_hz` in the mapping")
    else:
        start = min(float(np.min(s.t)) for s in logged)
        logged = [Series(s.t - start, s.values, s.left_out) for s in logged]
    shifts = (signal.shift_s for signal in mapping.signals())
    return _joined(source, mapping, [_shifted(s, shift) for s, shift in zip(logged, shifts, strict=True)])


def _decoded(series: Series, settings: SignalSettings) -> Series:
    values = decoded(series.values, settings.missing, settings.sign_bit, settings.wraps_at)
    return Series(series.t, values, np.isnan(values) & ~np.isnan(series.values))


def _shifted(series: Series, shift_s: float) -> Series:
    if series.left_out is None or not series.left_out.any():
        return Series(series.t + shift_s, series.values) if shift_s else series
    return Series(series.t[~series.left_out] + shift_s, series.values[~series.left_out])


def canonical_mapping(names: Sequence[str], path: str, clock: str = "") -> LogMapping:
    """Mapping of a log whose signals have the names of canonical columns, or of those of two axes.

    Args:
        clock: substitute for a missing `time_s`: a signal of times, or `log`; empty for none.

    Raises:
        LogError: if names are missing; lists the available ones and the remedy.
    """
    commands = {**CANONICAL.command, **TWO_AXES.command}
    outputs = {column: unit for unit, column in OUTPUT_COLUMN.items()} | {TWO_AXES.angle: "deg"}
    ends = {CANONICAL.spelled([name.rpartition(".")[2]])[0]: name for name in reversed(names)}
    command, angle = (next((name for name in known if name in ends), None) for known in (commands, outputs))
    if command is None or angle is None or ("time_s" not in ends and not clock):
        raise LogError(
            f"{path}: holds no time_s, command, angle_deg; expected these, or a mapping file after --layout; "
            f"available: {few(names, 120)}"
        )
    keys = ends.get("time_s", clock), ends[command], ends[angle]
    home = keys[1].rpartition(".")[0]
    others = [name for name in names if name not in keys and name.rpartition(".")[0] == home]
    channels = {name.rpartition(".")[2]: {"signal": name} for name in others}
    return LogMapping.parse(
        {
            "time": keys[0],
            "command": {"signal": keys[1], "unit": commands[command]},
            "angle": {"signal": keys[2], "unit": outputs[angle]},
            "channels": channels,
        },
        path,
    )


def split_path(path: str) -> list[str | int]:
    """Split a path into keys and indices: `position[0]` becomes `["position", 0]`, `[tendon]` stays a text."""
    steps = [plain or key for plain, key in _STEP.findall(path)]
    return [int(part) if part.lstrip("-").isdigit() else part for part in steps]


def walk(value: Any, steps: Sequence[str | int], single: bool = False) -> Any:
    """Follow keys, attributes and indices into a message; a text index looks up the message's list `name`.

    Args:
        single: whether a list of one element and the element are equivalent, as a struct and a 1x1 struct array in
            MATLAB.

    Raises:
        KeyError: if a step does not exist; holds the step.
    """
    owner: Any = None
    for step in steps:
        if single and step == 0 and isinstance(value, Mapping):
            continue
        if single and isinstance(step, str) and isinstance(value, list) and len(value) == 1:
            value = value[0]
        following = _enter(value, step, owner)
        if following is KeyError:
            raise KeyError(step)
        owner, value = value, following
    return value


def missing(path: str, name: str, names: Sequence[str]) -> LogError:
    """Error for a signal that is not in the log."""
    choice = f"available: {few(sorted(names), 90)}{nearest(name, names[:_MOST_COMPARED])}"
    return LogError(f"{path}: no signal {shown(name, 40)}; {choice if names else 'the log holds no numbers'}")


def _enter(value: Any, step: str | int, owner: Any) -> Any:
    """Value after one step of `walk`; the class KeyError if there is none."""
    if isinstance(value, Mapping):
        return value.get(step, KeyError)
    if not hasattr(value, "__len__") or isinstance(value, str):
        return KeyError if isinstance(step, int) or step.startswith("_") else getattr(value, step, KeyError)
    if isinstance(step, str):  # position[tendon] of a JointState, whose `name` lists the joints
        joints = list(owner.get("name", ()) if isinstance(owner, Mapping) else getattr(owner, "name", ()))
        step = joints.index(step) if step in joints else len(value)
    return value[step] if -len(value) <= step < len(value) else KeyError


def _combined(path: str, mapping: LogMapping, logged: Sequence[Series]) -> list[Series]:
    """Signals of the mapping, each with its second one, which are at the end of `logged`, in order."""
    signals = mapping.signals()
    taken = iter(logged[len(signals) :])
    left = []
    for settings, series in zip(signals, logged, strict=False):
        if settings.second is not None:
            other, sign = next(taken), 1.0 if settings.plus is not None else -1.0
            if not np.array_equal(other.t, series.t, equal_nan=True):
                raise LogError(
                    f"{path}: {settings.signal!r} and {settings.second!r} have other time stamps, "
                    f"expected a {'difference' if sign < 0 else 'sum'} of two fields of one message"
                )
            both = None if series.left_out is None or other.left_out is None else series.left_out | other.left_out
            series = Series(series.t, series.values + sign * other.values, both)
        left.append(series)
    return left


def _joined(source: SignalLog, mapping: LogMapping, logged: Sequence[Series]) -> UncheckedLog:
    command, angle = (_ordered(s) for s in logged[:2])
    base, other = (logged[1], command) if mapping.base == "angle" else (logged[0], angle)
    with np.errstate(invalid="ignore"):
        inside = ~((base.t < other.t[0]) | (base.t > other.t[-1]))  # stamps that are no number stay and are reported
    t = base.t[inside]
    if t.size < 2:
        spans = " and ".join(f"{s.t[0]:.6g} to {s.t[-1]:.6g} s" for s in (command, angle))
        raise LogError(
            f"{source.path}: command and angle share {t.size} samples (they span {spans}), expected 2 or more"
            f"{_two_clocks(mapping, command, angle)}"
        )
    signals = [_at(t, series, settings) for series, settings in zip(logged, mapping.signals(), strict=True)]
    # The base signal keeps its values without interpolation, even at repeated stamps.
    k = 1 if mapping.base == "angle" else 0
    settings = mapping.signals()[k]
    signals[k] = settings.scale * base.values[inside] + settings.offset
    unit, factor = COMMAND_UNIT_OF.get(mapping.command.unit, (mapping.command.unit, 1.0))
    angle_unit, angle_factor = ANGLE_UNIT_OF.get(mapping.angle.unit, (mapping.angle.unit, 1.0))
    others = iter(signals[2:])
    log = UncheckedLog(
        t,
        factor * signals[0],
        angle_factor * signals[1],
        {name: next(others) for name in mapping.channels},
        Units(unit, angle_unit, inverse=False),
        source.path,
        mapping.name,
        source.note,
        inputs={
            name: next(others) if (value := settings.number(source.path)) is None else np.full(t.size, value)
            for name, settings in mapping.inputs.items()
        },
    )
    return log if mapping.tip is None else _with_tip(log, mapping.tip, [signals[1], *others])


def _with_tip(log: UncheckedLog, tip: TipSignals, values: Sequence[Vec]) -> UncheckedLog:
    """Log whose two angles are those of a tip."""
    try:
        x, y = tip.angles(values).T
    except LogError as error:
        raise LogError(f"{log.source}: {error}") from None
    units = Units(log.units.command, "deg", inverse=False)
    return replace(log, angle=np.ascontiguousarray(x), channels={**log.channels, ANGLE_Y: y.copy()}, units=units)


def _two_clocks(mapping: LogMapping, command: Series, angle: Series) -> str:
    shift = shift_between(command.t, command.values, angle.t, angle.values)
    if shift is None:
        return "; are their clocks two?"
    other = ", or `time: log`" if mapping.time == HEADER_TIME else ""
    late = "late" if shift.late_s > 0 else "early"
    key = f"`angle: {{..., shift_s: {-shift.late_s:.4g}}}`"
    return f"; the angle's clock is about {abs(shift.late_s):.4g} s {late}: {key}{other}"


def _ordered(series: Series) -> Series:
    """Samples with finite stamps, sorted by time; of equal stamps only the last one."""
    order = np.argsort(series.t, kind="stable")
    order = order[np.isfinite(series.t[order])]
    t = series.t[order]
    last = np.append(np.diff(t) > 0, True)[: t.size]
    if not t.size:
        return Series(np.array([np.nan]), np.array([np.nan]))
    return Series(t[last], series.values[order][last])


def _at(t: Vec, series: Series, settings: SignalSettings) -> Vec:
    same = t.size == series.t.size and np.array_equal(t, series.t)
    return settings.scale * (series.values if same else at_times(t, series, settings.hold)) + settings.offset


def at_times(t: Vec, series: Series, hold: bool) -> Vec:
    """Values of a signal at times t, held or interpolated; not-a-number outside its span."""
    known = _ordered(series)
    if hold:
        values = known.values[np.clip(np.searchsorted(known.t, t, side="right") - 1, 0, None)]
    else:
        values = np.interp(t, known.t, known.values)
    return np.where((t < known.t[0]) | (t > known.t[-1]), np.nan, values)


_LEAST_ROWS = 10
_SHARE = 0.2  # of rows that lack one of the two; fewer are single missing cells, which are named
_EVEN = 3.0  # times the median: a longer run of empty cells is a dropout


def is_merged(command: Vec, angle: Vec) -> bool:
    """Whether command and angle of a table are in separate rows, so that empty cells are no lost values.

    At least a fifth of the rows must hold only one of the two signals, and one of these must be true: the command is in
    every row with the angle; fewer than half of the rows hold both; or the command has a value every few rows
    throughout. A command missing for a while among complete rows is lost.
    """
    has_command, has_angle = ~np.isnan(command), ~np.isnan(angle)
    one, both = has_command ^ has_angle, has_command & has_angle
    if command.size < _LEAST_ROWS or one.sum() < _SHARE * command.size or min(has_command.sum(), has_angle.sum()) < 2:
        return False
    runs = np.diff(np.flatnonzero(has_command))
    regular = bool(runs.max() <= _EVEN * max(1.0, float(np.median(runs))))
    return bool(not (has_angle & ~has_command).any() or 2 * both.sum() < one.sum() + both.sum() or regular)


def filled_rows(t: Vec, values: Vec) -> Series:
    """Values of a signal in the nonempty rows of a table."""
    there = ~np.isnan(values) & np.isfinite(t)
    return Series(t[there], values[there])


def merged(t: Vec, command: Vec, angle: Vec, channels: Mapping[str, Vec]) -> tuple[Index, Vec, Vec, dict[str, Vec]]:
    """Rows of the angle within the span of the command, with the other signals at their times.

    Returns:
        rows of the table, (T,); time; the command, which keeps its last value until the next one; channels,
        interpolated between their rows.
    """
    u = filled_rows(t, command)
    inside = ~np.isnan(angle) & np.isfinite(t)
    if u.t.size:
        inside &= (t >= u.t.min()) & (t <= u.t.max())
    base = t[inside]
    others = {name: at_times(base, filled_rows(t, values), hold=False) for name, values in channels.items()}
    return np.flatnonzero(inside), base, at_times(base, u, hold=True), others


def merged_note(command: Vec, angle: Vec) -> str:
    """Note on a log with signals in separate rows."""
    return (
        f"signals lie in rows of their own: {np.count_nonzero(~np.isnan(command))} of the command, "
        f"{np.count_nonzero(~np.isnan(angle))} of the angle; the command keeps its value until its next row"
    )

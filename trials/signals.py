"""Signals with time stamps of their own, brought to one time base: what the readers of all formats have in common."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .clock_shift import shift_between
from .clocks import SECONDS, without_wraps
from .encodings import decoded
from .errors import LogError, nearest, shown
from .layouts import (
    ANGLE_UNIT_OF,
    CANONICAL,
    COMMAND_UNIT_OF,
    HEADER_TIME,
    LOG_TIME,
    OUTPUT_UNITS,
    LogMapping,
    SignalSettings,
    few,
)
from .trial import Trial, Units
from .types import Vec

_MOST_COMPARED = 2000  # names among which the nearest is looked for
_STEP = re.compile(r"\.?([^.\[\]]+)|\[([^\[\]]+)\]")


@dataclass(frozen=True, eq=False)
class Series:
    """One signal.

    Attributes:
        t: time stamps [s], (T,); of a log whose samples have none, not-a-number throughout.
        values: as logged, (T,); not-a-number where the log says null.
        left_out: samples whose value stands for a missing one, (T,); None for none.
    """

    t: Vec
    values: Vec
    left_out: NDArray[np.bool_] | None = None


class Source(Protocol):
    """An open log of named signals."""

    @property
    def path(self) -> str:
        """The file or folder, for messages."""
        ...

    @property
    def note(self) -> str:
        """What a user should know about the file, such as that it is cut off; empty if nothing."""
        ...

    def names(self) -> tuple[str, ...]:
        """Every signal that can be asked for."""
        ...

    def series(self, signals: Sequence[str], time: str) -> list[Series]:
        """The signals asked for.

        Args:
            signals: names, as in `names`.
            time: `log`, `header`, or the name of a signal that holds time.

        Raises:
            LogError: on a signal that is not there; names it and those that are.
        """
        ...


@dataclass(frozen=True, eq=False)
class Raw:
    """A log on one time base, its values not yet judged.

    Attributes:
        t, command, angle: (T,).
        channels: further signals, (T,) each.
        units: of command and angle.
        source: path of the log.
        layout: name of the layout it was read with.
        note: what a user should know about the file; empty if nothing.
    """

    t: Vec
    command: Vec
    angle: Vec
    channels: Mapping[str, Vec]
    units: Units
    source: str
    layout: str
    note: str = ""

    def trial(self) -> Trial:
        """The log as a trial.

        Raises:
            LogError: if values are not finite, time does not increase, or fewer than two samples are left.
        """
        return Trial(self.t, self.command, self.angle, self.channels, self.units, self.source)


def read_mapped(source: Source, mapping: LogMapping) -> Raw:
    """Bring the signals of a mapping to one time base.

    The base is the time stamps of the angle (or of the command, as the mapping says) that lie inside the span of the
    other one. The command keeps its last value until the next (it is what the device was told); measured signals are
    interpolated linearly; a channel is not-a-number outside its own span. Time starts at zero with the first message
    where it is the log's or the header's; a time signal keeps its origin.

    Raises:
        LogError: if a signal is missing, is empty, or command and angle have no time in common; if a signal and what
            is to be taken from it have other time stamps.
    """
    wanted = [signal.signal for signal in mapping.signals()]
    own_time = mapping.rate_hz is None and mapping.time not in (LOG_TIME, HEADER_TIME)
    taken = [signal.minus for signal in mapping.signals() if signal.minus is not None]
    found = source.series([*wanted, *taken], mapping.time if mapping.rate_hz is None else LOG_TIME)
    for name, series in zip([*wanted, *taken], found, strict=True):
        if not series.values.size:
            raise LogError(f"{source.path}: signal {name!r} is empty, expected samples{_and(source.note)}")
    owners = [*mapping.signals(), *(signal for signal in mapping.signals() if signal.minus is not None)]
    found = _differences(source.path, mapping, [_decoded(s, owner) for s, owner in zip(found, owners, strict=True)])
    if mapping.rate_hz is not None:
        found = [Series(np.arange(s.values.size) / mapping.rate_hz, s.values, s.left_out) for s in found]
    elif own_time:
        found = [Series(_seconds(s.t, mapping), s.values, s.left_out) for s in found]
    elif np.isnan(found[0].t).all():
        raise LogError(f"{source.path}: no time stamps of its own, expected `time: SIGNAL` or `rate_hz` in the mapping")
    else:
        start = min(float(np.min(s.t)) for s in found)
        found = [Series(s.t - start, s.values, s.left_out) for s in found]
    shifts = (signal.shift_s for signal in mapping.signals())
    return _joined(source, mapping, [_shifted(s, shift) for s, shift in zip(found, shifts, strict=True)])


def _decoded(series: Series, settings: SignalSettings) -> Series:
    """The signal as it is encoded in the log; samples whose value stands for a missing one are to be left out."""
    values = decoded(series.values, settings.missing, settings.sign_bit, settings.wraps_at)
    return Series(series.t, values, np.isnan(values) & ~np.isnan(series.values))


def _seconds(t: Vec, mapping: LogMapping) -> Vec:
    """Stamps of a time signal [s]."""
    whole = t if mapping.time_wraps_at is None else without_wraps(t, mapping.time_wraps_at)
    return whole * SECONDS[mapping.time_unit]


def _shifted(series: Series, shift_s: float) -> Series:
    """The samples that count, at their own time."""
    if series.left_out is None or not series.left_out.any():
        return Series(series.t + shift_s, series.values) if shift_s else series
    return Series(series.t[~series.left_out] + shift_s, series.values[~series.left_out])


def canonical_mapping(names: Sequence[str], path: str, clock: str = "") -> LogMapping:
    """The mapping of a log whose signals have the names of canonical columns, told from the names alone.

    Args:
        names: of the signals.
        path: of the log, for messages.
        clock: what stands in for a missing `time_s`: a signal that is one by its kind, or `log`; empty for none.

    Raises:
        LogError: if they have not; lists what there is and says what to do.
    """
    commands = {"command": "mm"} | {f"command_{unit}": unit for unit in COMMAND_UNIT_OF}
    ends = {CANONICAL.spelled([name.rpartition(".")[2]])[0]: name for name in reversed(names)}
    outputs = {"angle_deg": "deg"} | {f"angle_{unit}": unit for unit in OUTPUT_UNITS}
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
    """`position[0]` as `["position", 0]`; `[tendon]` stays a text."""
    found = [plain or key for plain, key in _STEP.findall(path)]
    return [int(part) if part.lstrip("-").isdigit() else part for part in found]


def walk(value: Any, steps: Sequence[str | int], single: bool = False) -> Any:
    """Follow keys, attributes and indices into a message; a text index looks up the message's list `name`.

    Args:
        value: the message.
        steps: as `split_path` gives them.
        single: whether the one element of a list may also be written without it, and `[0]` of what is no list: MATLAB
            makes no difference between a struct and an array of one.

    Raises:
        KeyError: where the way ends; holds the step.
    """
    owner: Any = None
    for step in steps:
        if single and step == 0 and isinstance(value, Mapping):
            continue
        if single and isinstance(step, str) and isinstance(value, list) and len(value) == 1:
            value = value[0]
        found = _enter(value, step, owner)
        if found is KeyError:
            raise KeyError(step)
        owner, value = value, found
    return value


def missing(path: str, name: str, names: Sequence[str]) -> LogError:
    """What to raise where a signal is not in the log."""
    choice = f"available: {few(sorted(names), 90)}{nearest(name, names[:_MOST_COMPARED])}"
    return LogError(f"{path}: no signal {shown(name, 40)}; {choice if names else 'the log holds no numbers'}")


def _enter(value: Any, step: str | int, owner: Any) -> Any:
    """One step of `walk`; KeyError, not raised, where there is no such way."""
    if isinstance(value, Mapping):
        return value.get(step, KeyError)
    if not hasattr(value, "__len__") or isinstance(value, str):
        return KeyError if isinstance(step, int) or step.startswith("_") else getattr(value, step, KeyError)
    if isinstance(step, str):  # position[tendon] of a JointState, whose `name` lists the joints
        joints = list(owner.get("name", ()) if isinstance(owner, Mapping) else getattr(owner, "name", ()))
        step = joints.index(step) if step in joints else len(value)
    return value[step] if -len(value) <= step < len(value) else KeyError


def _differences(path: str, mapping: LogMapping, found: Sequence[Series]) -> list[Series]:
    """The mapping's signals, less what is to be taken from them; `found` has the latter at its end, in order."""
    signals = mapping.signals()
    taken = iter(found[len(signals) :])
    left = []
    for settings, series in zip(signals, found, strict=False):
        if settings.minus is not None:
            other = next(taken)
            if not np.array_equal(other.t, series.t, equal_nan=True):
                raise LogError(
                    f"{path}: {settings.signal!r} and {settings.minus!r} have other time stamps, "
                    "expected a difference of two fields of one message"
                )
            both = None if series.left_out is None or other.left_out is None else series.left_out | other.left_out
            series = Series(series.t, series.values - other.values, both)
        left.append(series)
    return left


def _joined(source: Source, mapping: LogMapping, found: Sequence[Series]) -> Raw:
    command, angle = (_ordered(s) for s in found[:2])
    base, other = (found[1], command) if mapping.base == "angle" else (found[0], angle)
    with np.errstate(invalid="ignore"):
        inside = ~((base.t < other.t[0]) | (base.t > other.t[-1]))  # stamps that are no number stay and are reported
    t = base.t[inside]
    if t.size < 2:
        spans = " and ".join(f"{s.t[0]:.6g} to {s.t[-1]:.6g} s" for s in (command, angle))
        raise LogError(
            f"{source.path}: command and angle share {t.size} samples (they span {spans}), expected 2 or more"
            f"{_two_clocks(mapping, command, angle)}"
        )
    signals = [_at(t, series, settings) for series, settings in zip(found, mapping.signals(), strict=True)]
    # What gives the base keeps its values as they are: nothing of it is interpolated, not even where a stamp repeats.
    own = 1 if mapping.base == "angle" else 0
    signals[own] = mapping.signals()[own].scale * base.values[inside] + mapping.signals()[own].offset
    unit, factor = COMMAND_UNIT_OF.get(mapping.command.unit, (mapping.command.unit, 1.0))
    angle_unit, angle_factor = ANGLE_UNIT_OF.get(mapping.angle.unit, (mapping.angle.unit, 1.0))
    return Raw(
        t,
        factor * signals[0],
        angle_factor * signals[1],
        dict(zip(mapping.channels, signals[2:], strict=True)),
        Units(unit, angle_unit, inverse=False),
        source.path,
        mapping.name,
        source.note,
    )


def _two_clocks(mapping: LogMapping, command: Series, angle: Series) -> str:
    """What to do about two signals that have hardly any time in common, for the end of a line."""
    shift = shift_between(command.t, command.values, angle.t, angle.values)
    if shift is None:
        return "; are their clocks two?"
    other = ", or `time: log`" if mapping.time == HEADER_TIME else ""
    late = "late" if shift.late_s > 0 else "early"
    key = f"`angle: {{..., shift_s: {-shift.late_s:.4g}}}`"
    return f"; the angle's clock is about {abs(shift.late_s):.4g} s {late}: {key}{other}"


def _ordered(series: Series) -> Series:
    """In order of time, finite stamps only; of equal stamps the last one counts."""
    order = np.argsort(series.t, kind="stable")
    order = order[np.isfinite(series.t[order])]
    t = series.t[order]
    last = np.append(np.diff(t) > 0, True)[: t.size]
    if not t.size:
        return Series(np.array([np.nan]), np.array([np.nan]))
    return Series(t[last], series.values[order][last])


def _at(t: Vec, series: Series, settings: SignalSettings) -> Vec:
    """Values at times t, scaled."""
    if t.size == series.t.size and np.array_equal(t, series.t):
        return settings.scale * series.values + settings.offset
    own = _ordered(series)
    if settings.hold:
        values = own.values[np.clip(np.searchsorted(own.t, t, side="right") - 1, 0, None)]
    else:
        values = np.interp(t, own.t, own.values)
    values = np.where((t < own.t[0]) | (t > own.t[-1]), np.nan, values)
    return settings.scale * values + settings.offset


def _and(note: str) -> str:
    return f" ({note})" if note else ""

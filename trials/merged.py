"""Logs with a row for every event, in which each row holds some signals only and leaves the others' cells empty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .signals import Series
from .types import Index, Vec

_LEAST_ROWS = 10
_SHARE = 0.2  # of rows that lack one of the two; fewer are single cells that went missing, which are named
_EVEN = 3.0  # times the median: a longer run of empty cells is a dropout


@dataclass(frozen=True, eq=False)
class Merged:
    """Rows that hold the angle, with the other signals brought to their time.

    Attributes:
        rows: of the table, (T,).
        t, command, angle: (T,); the command keeps its last value until the next one.
        channels: interpolated between their own rows, not-a-number outside these.
        note: what was done, for the user.
    """

    rows: Index
    t: Vec
    command: Vec
    angle: Vec
    channels: Mapping[str, Vec]
    note: str


def is_merged(command: Vec, angle: Vec) -> bool:
    """Whether empty cells mean that a signal was logged in other rows, and not that a value was lost.

    So it is where at least a fifth of the rows hold one of the two signals only, and one of these is true: the command
    is in every row that holds the angle; fewer than half of the rows hold both; or the command has a value every few
    rows throughout. A command that is missing for a while among complete rows is lost.
    """
    has_command, has_angle = ~np.isnan(command), ~np.isnan(angle)
    one, both = has_command ^ has_angle, has_command & has_angle
    if command.size < _LEAST_ROWS or one.sum() < _SHARE * command.size or min(has_command.sum(), has_angle.sum()) < 2:
        return False
    runs = np.diff(np.flatnonzero(has_command))
    regular = bool(runs.max() <= _EVEN * max(1.0, float(np.median(runs))))
    return bool(not (has_angle & ~has_command).any() or 2 * both.sum() < one.sum() + both.sum() or regular)


def own_rows(t: Vec, values: Vec) -> Series:
    """A signal in the rows that hold it."""
    there = ~np.isnan(values) & np.isfinite(t)
    return Series(t[there], values[there])


def merged(t: Vec, command: Vec, angle: Vec, channels: Mapping[str, Vec]) -> Merged:
    """The rows of the angle that lie within the span of the command, with everything at their time."""
    u = own_rows(t, command)
    there: NDArray[np.bool_] = ~np.isnan(angle) & np.isfinite(t)
    if u.t.size:
        there &= (t >= u.t.min()) & (t <= u.t.max())
    base = t[there]
    others = {name: _between(base, own_rows(t, values)) for name, values in channels.items()}
    return Merged(np.flatnonzero(there), base, _last(base, u), angle[there], others, said_of(command, angle))


def said_of(command: Vec, angle: Vec) -> str:
    """What a user should know of such a log."""
    return (
        f"signals lie in rows of their own: {np.count_nonzero(~np.isnan(command))} of the command, "
        f"{np.count_nonzero(~np.isnan(angle))} of the angle; the command keeps its value until its next row"
    )


def _last(t: Vec, series: Series) -> Vec:
    """The last value at or before times t that lie within the signal's span."""
    order = np.argsort(series.t, kind="stable")
    if not order.size:
        return np.full(t.size, np.nan)
    return series.values[order[np.clip(np.searchsorted(series.t[order], t, side="right") - 1, 0, None)]]


def _between(t: Vec, series: Series) -> Vec:
    """Values at times t, interpolated; not-a-number outside the signal's span."""
    order = np.argsort(series.t, kind="stable")
    if not order.size:
        return np.full(t.size, np.nan)
    return np.interp(t, series.t[order], series.values[order], left=np.nan, right=np.nan)

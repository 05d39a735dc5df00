"""Reading and writing of trials as tables: delimited text, sheets and data frames, by the columns of a layout."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from .clocks import SECONDS
from .errors import LogError
from .files import write_atomically
from .formats import format_of, read_lines
from .layouts import (
    CANONICAL,
    COMMAND_UNIT_OF,
    COMMAND_UNITS,
    LAYOUTS,
    MAPPING_HINT,
    OUTPUT_COLUMN,
    Layout,
    UnitName,
    command_column,
    detect_layout,
    few,
    layout_named,
    unit_of,
)
from .signals import Cells, UncheckedLog, is_merged, merged, merged_note
from .tables import FrameLike, LogTable, frame_table, sheet_table, text_table
from .trial import Trial, Units, even_time
from .types import Vec
from .xlsx_ import open_xlsx


def format_table(columns: Mapping[str, Sequence[str] | NDArray[np.generic]]) -> str:
    """Write columns of equal length as comma-separated text; numbers read back exactly."""
    cells = [
        map(repr, c.tolist()) if isinstance(c, np.ndarray) and c.dtype.kind in "fiu" else c for c in columns.values()
    ]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*cells, strict=True))
    return out.getvalue()


def read_columns(
    log: Path | str | FrameLike, layout: str | Layout = "auto", sampled_hz: float | None = None
) -> UncheckedLog:
    """Read a log without any check of its values: empty cells are not-a-number, time may repeat.

    Columns of text are left out; `UncheckedLog.cells.table.texts` holds them.

    Raises:
        LogError: if the file cannot be read as a table or lacks a column; names file, row and column.
        ConfigError: on an unknown layout.
    """
    wanted = None if layout == "auto" else layout_named(layout) if isinstance(layout, str) else layout
    table, layout = _table_and_layout(log, wanted)
    path = table.source
    if gone := layout.missing(table.header):
        raise LogError(
            f"{path}: missing columns for layout {layout.name}: {', '.join(gone)}; "
            f"available: {few(table.header)}{_header_hint(table)}"
        )
    try:
        command = layout.command_column(table.header)
        angle_name, angle_unit = layout.angle_column(table.header)
    except LogError as error:
        raise LogError(f"{path}: {error}") from None
    names = {"t": layout.time, "command": command, "angle": angle_name}
    for name in names.values():
        if name in table.texts and (sampled_hz is None or name != layout.time):
            raise table.not_numbers(name)
    _require_units(table, {layout.time: "s", command: layout.command[command], angle_name: angle_unit})
    others = [k for k in table.numbers if k and k not in names.values()]  # a trailing comma makes a nameless column
    channels = {layout.channels.get(k, k): table.numbers[k] for k in others}
    unit, factor = COMMAND_UNIT_OF.get(layout.command[command], (layout.command[command], 1.0))
    u, angle = factor * table.numbers[command], table.numbers[angle_name]
    units, note, rows = Units(unit, angle_unit, inverse=False), table.left_out(names.values()), None
    if sampled_hz is not None:
        t = even_time(u.size, sampled_hz)
    else:
        t = table.numbers[layout.time]
        if is_merged(u, angle):
            note = "; ".join(filter(None, (merged_note(u, angle), note)))
            rows, t, u, channels = merged(t, u, angle, channels)
            angle = angle[rows]
    cells, ranges = Cells(table, names, rows), (layout.command_range, layout.angle_range)
    return UncheckedLog(t, u, angle, channels, units, path, layout.name, note, ranges, cells)


def read_csv(log: Path | str | FrameLike, layout: str | Layout = "auto") -> Trial:
    """Read one trial from a file or a data frame.

    Time, command and angle must be finite and time must increase; further columns may hold empty cells (read as
    not-a-number), and columns of text are left out.

    Raises:
        LogError: on anything else; one line with file, row, column, the actual and the expected value.
        ConfigError: on an unknown layout.
    """
    return read_columns(log, layout).trial()


def write_csv(trial: Trial, path: Path | str) -> Path:
    """Write a trial in canonical columns, completely or not at all; it reads back exactly.

    A command in mm is written as `command`, in another unit as `command_<unit>`; an output as `angle_<unit>`.

    Raises:
        LogError: if a channel has the name of a canonical column, or a unit cannot be named in the header.
    """
    unit = trial.units.command
    if unit not in COMMAND_UNITS or trial.units.angle not in OUTPUT_COLUMN or trial.inverted:
        raise LogError(
            f"{trial.source}: units are {unit} and {trial.units.angle}, "
            f"expected a command in {', '.join(COMMAND_UNITS)} and an output in {', '.join(OUTPUT_COLUMN)}"
        )
    reserved = {CANONICAL.time, *OUTPUT_COLUMN.values(), *CANONICAL.command}
    if clash := sorted(reserved & set(trial.channels)):
        raise LogError(f"{trial.source}: channel {clash[0]!r} has the name of a canonical column, expected another")
    signals = {command_column(unit): trial.command, OUTPUT_COLUMN[trial.units.angle]: trial.angle}
    columns = {CANONICAL.time: trial.t, **signals, **trial.channels}
    return write_atomically(path, format_table(columns))


def open_table(log: Path | str | FrameLike, wanted: Iterable[str] = ()) -> LogTable:
    """Open delimited text, a LabVIEW measurement, a sheet of a workbook, or a data frame as a table.

    The `wanted` names identify the header row, and the sheet.
    """
    if isinstance(log, FrameLike):
        return frame_table(log)
    if format_of(Path(log)) == "xlsx":
        return open_xlsx(log, wanted)
    lines = read_lines(log)
    is_lvm = lines[0].lstrip("\ufeff").startswith(_LVM)
    return lvm_table(lines, str(log)) if is_lvm else text_table(lines, str(log), wanted)


def _table_and_layout(log: Path | str | FrameLike, layout: Layout | None) -> tuple[LogTable, Layout]:
    """Columns of a log with their layout: the given one, otherwise the one that matches the header."""
    wanted = layout.known() if layout is not None else [name for layout in LAYOUTS for name in layout.known()]
    table = open_table(log, wanted)
    header, clock = table.header, _clock(table, (layout or CANONICAL).spelled(table.header), (layout or CANONICAL).time)
    if layout is None:
        try:
            layout = detect_layout([CANONICAL.time if name == clock else name for name in header])
        except LogError as error:
            where = table.source if isinstance(log, FrameLike) else f"{table.source}, row {table.header_row}"
            raise LogError(f"{where}: {error}{_header_hint(table)}") from None
    if clock and layout.time not in header:
        layout = replace(layout, time=clock)
    return table.renamed(layout.spelled(header)), layout


def _clock(table: LogTable, header: Sequence[str], time: str) -> str:
    """Column of dates or times of day that replaces a missing time column: the one with most different values."""
    dates = sorted(name for name in table.times if name in table.numbers)
    if time in header or not dates:
        return ""
    return max(dates, key=lambda name: np.unique(table.numbers[name]).size)


def _require_units(table: LogTable, expected: Mapping[str, str]) -> None:
    """Refuse a row of units that contradicts the names of the columns."""
    for name, unit in expected.items():
        said = unit_of(table.units.get(name, ""))
        if said and said != unit and said in {*get_args(UnitName), *SECONDS} and name not in table.times:
            raise LogError(
                f"{table.source}, row {table.header_row + 1}: the unit below {name!r} is {said}, expected {unit}; "
                "name it in a mapping file (--layout map.yaml) or correct the row"
            )


def _header_hint(table: LogTable) -> str:
    if table.named:
        return MAPPING_HINT
    return " (the first row holds numbers, expected column names; a mapping file can name columns '[0]', '[1]')"


_LVM = "LabVIEW Measurement"
_END = "***End_of_Header***"
X_VALUE, _COMMENT = "X_Value", "Comment"
_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";", "space": " "}


def lvm_table(lines: Sequence[str], source: str) -> LogTable:
    """Columns of a LabVIEW measurement; `X_Value` [s] is computed from `X0` and `Delta_X` if it is empty.

    Raises:
        LogError: if a header is cut off, channels have separate times, or there are no rows.
    """
    ends = [k for k, line in enumerate(lines) if line.startswith(_END)]
    if not ends:
        raise LogError(f"{source}: LabVIEW measurement without {_END}, expected a whole file")
    declared = next((line[len("Separator") :] for line in lines[: ends[0]] if line.startswith("Separator")), "\t")
    separator = _SEPARATORS.get(declared.strip(" \t,;").lower(), declared[:1])
    keys = _keys(lines[: ends[0]], separator)
    comma = keys.get("decimal_separator", ["."])[0] == ","
    blocks = list(_blocks(lines, ends, separator))
    if not blocks:
        raise LogError(f"{source}: LabVIEW measurement with a header only, expected rows of numbers")
    about, names, _ = blocks[0]
    if any(other != names for _, other, _ in blocks):
        raise LogError(
            f"{source}: LabVIEW measurement whose parts have other channels; write each to a file of its own"
        )
    kept = [k for k, name in enumerate(names) if name and name != _COMMENT]
    x = [k for k in kept if names[k] == X_VALUE]
    if len(x) > 1:
        raise LogError(
            f"{source}: LabVIEW measurement with a time column for each channel (X_Columns Multi), expected one: "
            "set X value columns to `one` in LabVIEW, or write each channel to a file of its own"
        )
    first = 1 + next(k for k, line in enumerate(lines) if k > ends[0] and X_VALUE in line)
    rows: list[list[str]] = [[] for _ in range(first - 1)] + [[names[k] for k in kept]]
    for _, _, cells in blocks:
        rows += [[row[k] if k < len(row) else "" for k in kept] for row in cells]
    if comma:
        rows[first:] = [[cell.replace(",", ".") for cell in row] for row in rows[first:]]
    table = sheet_table(rows, source, [X_VALUE])
    if not x or about.get("x_dimension", ["Time"])[0].lower() != "time":
        return table
    stamps: Vec = table.numbers.get(X_VALUE, np.array([np.nan]))
    if np.isnan(stamps).all():
        start, step = (_number(source, about, key) for key in ("x0", "delta_x"))
        count = len(next(iter(table.numbers.values())))
        stamps = start + step * np.arange(count, dtype=np.float64)
    return replace(table, numbers={**table.numbers, X_VALUE: stamps}, times=table.times | {X_VALUE})


def _keys(lines: Sequence[str], separator: str) -> Mapping[str, list[str]]:
    """Lower-case keys of a header, and their values, one per channel."""
    rows = [[cell.strip() for cell in line.split(separator)] for line in lines]
    return {row[0].lower(): [cell for cell in row[1:] if cell] or [""] for row in rows if row and row[0]}


def _blocks(
    lines: Sequence[str], ends: Sequence[int], separator: str
) -> Iterator[tuple[Mapping[str, list[str]], list[str], list[list[str]]]]:
    """Header, column names and rows of every part of a file."""
    for number, end in enumerate(ends):
        begin = ends[number - 1] + 1 if number else 0
        stop = ends[number + 1] if number + 1 < len(ends) else len(lines)
        body = [[cell.strip() for cell in line.split(separator)] for line in lines[end + 1 : stop]]
        head = next((k for k, row in enumerate(body) if row[0] == X_VALUE), None)
        if head is None:
            continue
        rows = []
        for row in body[head + 1 :]:
            if row[0].lower() in ("channels", _LVM.lower()):  # the header of the next part
                break
            if any(row):
                rows.append(row)
        yield _keys(lines[begin:end], separator), body[head], rows


def _number(source: str, about: Mapping[str, list[str]], key: str) -> float:
    text = about.get(key, [""])[0].replace(",", ".")
    try:
        return float(text)
    except ValueError:
        raise LogError(
            f"{source}: LabVIEW measurement without times, whose {key} is {text[:40]!r}, expected a number"
        ) from None

"""Trials from and to tables: delimited text and data frames; a bad cell is named by its row and column."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .errors import LogError
from .files import write_atomically
from .layouts import (
    CANONICAL,
    COMMAND_UNITS,
    MAPPING_HINT,
    OUTPUT_COLUMN,
    Preset,
    command_column,
    detect_preset,
    get_preset,
)
from .trial import Trial, Units, clock_advice, even_time
from .types import Vec

_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_DECIMAL_COMMA = re.compile(r"(?<![^;\t])( *[-+]?\d*),(\d+(?:[eE][-+]?\d+)? *)(?![^;\t])")  # the whole of a cell


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one file or data frame.

    Attributes:
        source: path of the file, for messages.
        lines: text of the file, line by line; none of a data frame.
        delimiter: what separates the cells.
        start: index of the first line below the header.
        header: names of all columns in the order of the file.
        numbers: columns of numbers, each (T,), not-a-number where the cell is empty or says so.
        texts: columns whose first cell is text, each of length T.
    """

    source: str
    lines: Sequence[str]
    delimiter: str
    start: int
    header: tuple[str, ...]
    numbers: Mapping[str, Vec]
    texts: Mapping[str, tuple[str, ...]]

    def locate(self, sample: int, column: str) -> tuple[int, str]:
        """Row and text of one cell; rows of a file count from 1, as an editor shows them, of a data frame from 0."""
        if not self.lines:
            return sample, str(self.texts[column][sample] if column in self.texts else self.numbers[column][sample])
        rows = list(_rows(self.lines, self.start, self.delimiter, self.source))
        number, cells = rows[sample]
        return number, cells[self.header.index(column)].strip()


@runtime_checkable
class Frame(Protocol):
    """Named columns in memory, such as a pandas or polars `DataFrame`; neither package is imported."""

    @property
    def columns(self) -> Any:
        """Names of the columns, in order."""
        ...

    def __getitem__(self, name: Any, /) -> Any:
        """One column, as `numpy.asarray` takes it."""
        ...


def frame_table(frame: Frame, source: str = "<frame>") -> Table:
    """Columns of a data frame; an index that has a name is a column too.

    Raises:
        LogError: if a name occurs twice, or there is no row.
    """
    header = tuple(map(str, frame.columns))
    columns = {name: np.asarray(frame[key]) for name, key in zip(header, frame.columns, strict=True)}
    index = getattr(frame, "index", None)
    name = getattr(index, "name", None)
    if name is not None and str(name) not in columns:
        header, columns = (str(name), *header), {str(name): np.asarray(index), **columns}
    if twice := sorted(name for name in set(header) if header.count(name) > 1):
        raise LogError(f"{source}: column {twice[0]!r} occurs twice, expected each once")
    if not columns or not len(columns[header[0]]):
        raise LogError(f"{source}: no rows, expected at least two of numbers")
    numbers = {k: np.asarray(v, dtype=np.float64) for k, v in columns.items() if v.dtype.kind in "fiub"}
    for k, v in columns.items():  # a column with gaps may hold objects
        if v.dtype.kind == "O":
            with suppress(TypeError, ValueError):
                numbers[k] = np.array([np.nan if cell is None else cell for cell in v], dtype=np.float64)
    texts = {k: tuple(map(str, v)) for k, v in columns.items() if k not in numbers}
    return Table(source, (), "", 0, header, numbers, texts)


def read_lines(path: Path | str) -> list[str]:
    """Text of a file, line by line; a byte order mark, CRLF and a missing last newline make no difference.

    Raises:
        LogError: if the path is missing, a folder, unreadable, binary or empty.
    """
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise LogError(f"{path}: is a folder, expected a file") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from None
    if bad := _CONTROL.search(data):
        raise LogError(f"{path}: binary (byte {bad.group()[0]:#04x} at offset {bad.start()}), expected delimited text")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # logs of older lab software; every byte has a meaning in it
    if not text.strip():
        raise LogError(f"{path}: empty file, expected a header row and at least two rows of numbers")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def split_lines(lines: Sequence[str]) -> tuple[Sequence[str], str]:
    """Lines and what separates their cells: commas, semicolons, tabs or spaces, as the first row that is not blank has.

    Spaces become commas. Numbers with decimal commas get points where semicolons or tabs separate the cells.
    """
    head = next(line for line in lines if line.strip())
    delimiter = max(",;\t", key=head.count)
    if delimiter != ",":
        return [_DECIMAL_COMMA.sub(r"\1.\2", line) for line in lines], delimiter
    if delimiter not in head and " " in head.strip():
        return [",".join(line.split()) for line in lines], ","
    return lines, ","


def first_row(lines: Sequence[str], delimiter: str) -> tuple[int, tuple[str, ...]]:
    """Index and cells of the first line that is not blank."""
    index = next(k for k, line in enumerate(lines) if line.strip())
    return index, tuple(cell.strip() for cell in next(csv.reader([lines[index]], delimiter=delimiter)))


def read_table(lines: Sequence[str], source: str, delimiter: str = ",", names: Sequence[str] = ()) -> Table:
    """Columns of delimited text, named by its first row or, where given, by `names`.

    A last line that has no line end and too few cells was cut off while it was written: it is left out.

    Raises:
        LogError: on a column named twice, no rows, a ragged row or text among numbers; names row and column.
    """
    index, cells = first_row(lines, delimiter)
    header, start = (tuple(names), index) if names else (cells, index + 1)
    if start < len(lines) and _is_unfinished(lines[-1], delimiter, len(header)):
        lines = lines[:-1]
    twice = sorted({name for name in header if name and header.count(name) > 1})
    if twice:
        raise LogError(f"{source}, row {index + 1}: column {twice[0]!r} occurs twice, expected each once")
    first = next(iter(_rows(lines, start, delimiter, source)), None)
    if first is None:
        raise LogError(f"{source}: header only, expected at least two rows of numbers")
    kinds = [_number(cell) is not None for cell in first[1]]
    wanted = [k for k, is_number in enumerate(kinds) if is_number and k < len(header)]
    block = None if not all(kinds) else _fast(lines[start:], delimiter, len(header))
    rows = [] if block is not None else _checked(_rows(lines, start, delimiter, source), header, source)
    if block is None:
        block = _convert(rows, header, wanted, source)
    numbers = {header[k]: np.ascontiguousarray(block[:, j]) for j, k in enumerate(wanted)}
    texts = {name: tuple(cells[k].strip() for _, cells in rows) for k, name in enumerate(header) if name not in numbers}
    return Table(source, lines, delimiter, start, header, numbers, texts)


def format_table(columns: Mapping[str, Sequence[str] | NDArray[np.generic]]) -> str:
    """Comma-separated text of columns of one length; numbers are written so that they read back exactly."""
    cells = [
        map(repr, c.tolist()) if isinstance(c, np.ndarray) and c.dtype.kind in "fiu" else c for c in columns.values()
    ]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*cells, strict=True))
    return out.getvalue()


def _rows(lines: Sequence[str], start: int, delimiter: str, source: str) -> Iterable[tuple[int, list[str]]]:
    """Row number (1-based) and cells of every row from `start` on that is not blank."""
    reader = csv.reader((line + "\n" for line in lines[start:]), delimiter=delimiter)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield start + reader.line_num, cells
    except csv.Error as error:  # a quote that is never closed
        raise LogError(f"{source}, row {start + reader.line_num}: {error}, expected delimited text") from None


def _is_unfinished(line: str, delimiter: str, width: int) -> bool:
    """Whether the last line, which has no line end, was cut off before its last cell."""
    return bool(line.strip()) and len(next(csv.reader([line], delimiter=delimiter), [])) < width


def _number(cell: str) -> float | None:
    """Value of a cell, not-a-number where it is empty, None where it is text."""
    text = cell.strip()
    if not text:
        return math.nan
    try:
        return None if "_" in text else float(text)  # Python reads 1_0 as 10, a log does not mean it
    except ValueError:
        return None


def _fast(lines: Sequence[str], delimiter: str, width: int) -> Vec | None:
    """All cells as numbers, or None where anything is unusual and must be read cell by cell."""
    if {line.count(delimiter) for line in lines if line} != {width - 1}:
        return None
    try:
        return np.loadtxt(lines, delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        return None


def _checked(rows: Iterable[tuple[int, list[str]]], header: Sequence[str], source: str) -> list[tuple[int, list[str]]]:
    """The rows, all as wide as the header."""
    kept = list(rows)
    for number, cells in kept:
        if len(cells) != len(header):
            raise LogError(f"{source}, row {number}: {len(cells)} cells, expected {len(header)} as in the header")
    return kept


def _convert(rows: Sequence[tuple[int, list[str]]], header: Sequence[str], wanted: Sequence[int], source: str) -> Vec:
    """Numbers of the wanted columns, (T, columns)."""
    block = np.empty((len(rows), len(wanted)))
    for i, (number, cells) in enumerate(rows):
        for j, k in enumerate(wanted):
            value = _number(cells[k])
            if value is None:
                raise LogError(
                    f"{source}, row {number}, column {header[k]!r}: got {cells[k].strip()!r}, expected a number"
                )
            block[i, j] = value
    return block


@dataclass(frozen=True, eq=False)
class Columns:
    """A log as it was written: numbers, but not yet checked to be finite or in order.

    Attributes:
        t, command, angle: time [s], command and tip angle [deg], each (T,).
        channels: further columns under their readable names, each (T,).
        units: units of command and angle.
        preset: the layout that was read.
        table: the text behind it, to name rows in messages.
        names: columns of the log behind `t`, `command` and `angle`.
    """

    t: Vec
    command: Vec
    angle: Vec
    channels: Mapping[str, Vec]
    units: Units
    preset: Preset
    table: Table
    names: Mapping[str, str]

    @property
    def source(self) -> str:
        """Path of the log."""
        return self.table.source

    def row(self, sample: int) -> int:
        """Row of a sample, 1-based as an editor shows it."""
        return self.table.locate(sample, self.names["t"])[0]


def read_columns(log: Path | str | Frame, preset: str | Preset = "auto", sampled_hz: float | None = None) -> Columns:
    """Read a log without judging its values: empty cells are not-a-number, time may repeat.

    Columns of text are left out; `Columns.table.texts` holds them.

    Raises:
        LogError: if the file cannot be read as a table or lacks a column; names file, row and column.
        ConfigError: on an unknown preset.
    """
    layout = None if preset == "auto" else get_preset(preset) if isinstance(preset, str) else preset
    table, layout = _table_and_layout(log, layout)
    path = table.source
    if gone := layout.missing(table.header):
        raise LogError(
            f"{path}: missing columns for preset {layout.name}: {', '.join(gone)}; "
            f"available: {', '.join(table.header)}{_header_hint(table.header)}"
        )
    try:
        command = layout.command_column(table.header)
        angle_name, angle_unit = layout.angle_column(table.header)
    except LogError as error:
        raise LogError(f"{path}: {error}") from None
    names = {"t": layout.time, "command": command, "angle": angle_name}
    for name in names.values():
        if name in table.texts:
            row, cell = table.locate(0, name)
            raise LogError(f"{path}, row {row}, column {name!r}: got {cell!r}, expected a number")
    others = [k for k in table.numbers if k and k not in names.values()]  # a trailing comma makes a nameless column
    channels = {layout.channels.get(k, k): table.numbers[k] for k in others}
    t, u, angle = (table.numbers[name] for name in names.values())
    if sampled_hz is not None:
        t = even_time(u.size, sampled_hz)
    units = Units(layout.command[command], angle_unit, inverse=False)
    return Columns(t, u, angle, channels, units, layout, table, names)


def read_csv(log: Path | str | Frame, preset: str | Preset = "auto", sampled_hz: float | None = None) -> Trial:
    """Read one trial from a file or a data frame.

    Time, command and angle must be finite and time must increase; further columns may hold empty cells (read as
    not-a-number), and columns of text are left out.

    Args:
        log: the file or frame.
        preset: its layout: a name, a `Preset`, or `auto` to tell it from the header.
        sampled_hz: rate [Hz] of a log that was sampled evenly, whose time stamps are not looked at.

    Raises:
        LogError: on anything else; one line with file, row, column, what was got and what was expected.
        ConfigError: on an unknown preset.
    """
    columns = read_columns(log, preset, sampled_hz)
    path = columns.source
    for name, values in (("t", columns.t), ("command", columns.command), ("angle", columns.angle)):
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            row, cell = columns.table.locate(int(bad[0]), columns.names[name])
            more = f" ({bad.size} such cells)" if bad.size > 1 else ""
            got = repr(cell) if cell else "an empty cell"
            raise LogError(
                f"{path}, row {row}, column {columns.names[name]!r}: got {got}, expected a finite number{more}"
            )
    late = np.flatnonzero(np.diff(columns.t) <= 0)
    if late.size:
        k = int(late[0])
        raise LogError(
            f"{path}, row {columns.row(k + 1)}, column {columns.names['t']!r}: got {columns.t[k + 1]:.9g} s after "
            f"{columns.t[k]:.9g} s, expected increasing time ({late.size} such rows){clock_advice(columns.t)}"
        )
    return Trial(columns.t, columns.command, columns.angle, columns.channels, columns.units, path)


def write_csv(trial: Trial, path: Path | str) -> Path:
    """Write a trial in canonical columns, whole or not at all; it reads back exactly.

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


def _table_and_layout(log: Path | str | Frame, layout: Preset | None) -> tuple[Table, Preset]:
    """The columns of a log, and their layout: the one given, or what the header tells."""
    if isinstance(log, Frame):
        table = frame_table(log)
        layout = layout or _detect(table.header, table.source)
        return _spelled(table, layout), layout
    (lines, delimiter), source = split_lines(read_lines(log)), str(log)
    if layout is None:
        index, header = first_row(lines, delimiter)
        layout = _detect(header, f"{source}, row {index + 1}")
    return _spelled(read_table(lines, source, delimiter, layout.columns), layout), layout


def _spelled(table: Table, layout: Preset) -> Table:
    """The table with its columns named as the layout writes them."""
    header = layout.spelled(table.header)
    names = dict(zip(table.header, header, strict=True))
    numbers = {names[name]: values for name, values in table.numbers.items()}
    return replace(table, header=header, numbers=numbers, texts={names[k]: v for k, v in table.texts.items()})


def _detect(header: Sequence[str], where: str) -> Preset:
    """Layout told from the header row."""
    try:
        return detect_preset(header)
    except LogError as error:
        raise LogError(f"{where}: {error}{_header_hint(header)}") from None


def _header_hint(header: Sequence[str]) -> str:
    """What to add where the first row holds none of the names."""
    numbers = all(cell.lstrip("+-")[:1].isdigit() for cell in header)
    return " (the first row holds numbers, expected column names)" if numbers else MAPPING_HINT

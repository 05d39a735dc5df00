"""Tables: named columns of delimited text, of sheets and of data frames; a bad cell is named by its row and column."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Protocol, runtime_checkable

import numpy as np

from .cells import Converted, convert, is_value
from .errors import LogError, shown
from .grid import BLANK, Grid, cells_of, grid_of_cells, grid_of_lines
from .types import Vec

_COMMENTS = ("#", "%", "//")
Row = tuple[int, Sequence[str]]  # its number, counted from 1 as an editor shows it, and its cells


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one file or data frame.

    Attributes:
        source: path of the file, for messages.
        header: names of all columns in the order of the file; `[0]`, `[1]`, ... where no row names them.
        numbers: columns of numbers, each (T,), not-a-number where the cell is empty or says so.
        texts: columns of anything else, each of length T.
        times: names of the columns of `numbers` that were dates or times of day; they are in seconds since the first.
        units: what a row of units below the header says, by name of the column.
        named: whether a row of the file names the columns.
        header_row: row of the names, counted from 1.
        faults: of a column that holds numbers and something else: first such sample, and what to add to its error.
        rows: finds the rows again, to name them in messages; none of a data frame.
    """

    source: str
    header: tuple[str, ...]
    numbers: Mapping[str, Vec]
    texts: Mapping[str, tuple[str, ...]]
    times: frozenset[str] = frozenset()
    units: Mapping[str, str] = field(default_factory=dict)
    named: bool = True
    header_row: int = 1
    faults: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    rows: Callable[[], Sequence[Row]] | None = None

    def locate(self, sample: int, column: str) -> tuple[int, str]:
        """Row and text of one cell; rows of a file count from 1, as an editor shows them, of a data frame from 0."""
        if self.rows is None:
            return sample, str(self.texts[column][sample] if column in self.texts else self.numbers[column][sample])
        number, cells = self.rows()[sample]
        return number, cells[self.header.index(column)].strip()

    def renamed(self, header: tuple[str, ...]) -> Table:
        """The table with other names of its columns, in their order."""
        new = dict(zip(self.header, header, strict=True))
        return replace(
            self,
            header=header,
            numbers={new[name]: values for name, values in self.numbers.items()},
            texts={new[name]: values for name, values in self.texts.items()},
            times=frozenset(new[name] for name in self.times),
            units={new[name]: unit for name, unit in self.units.items()},
            faults={new[name]: fault for name, fault in self.faults.items()},
        )

    def left_out(self, asked: Iterable[str]) -> str:
        """What to say of columns that begin with numbers, hold something else further on, and are not asked for."""
        faults = {name: fault[0] for name, fault in self.faults.items() if name not in asked}
        if not faults:
            return ""
        name, sample = next(iter(faults.items()))
        row, cell = self.locate(sample, name)
        more = f" and {len(faults) - 1} more" if len(faults) > 1 else ""
        return f"column {shown(name, 40)}{more} left out: row {row} holds {shown(cell, 40)}, no number"

    def not_numbers(self, column: str) -> LogError:
        """What to raise where a column of `texts` is asked for as numbers."""
        sample, why = self.faults.get(column, (0, ""))
        row, cell = self.locate(sample, column)
        expected = f"expected a number{f'; {why}' if why else ''}"
        return LogError(f"{self.source}, row {row}, column {column!r}: got {shown(cell, 60)}, {expected}")


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
    """Columns of a data frame; an index that has a name is a column too, and dates are seconds since the first.

    Raises:
        LogError: if a name occurs twice, or there is no row.
    """
    header = tuple(map(str, frame.columns))
    columns = {name: np.asarray(frame[key]) for name, key in zip(header, frame.columns, strict=True)}
    index = getattr(frame, "index", None)
    name = getattr(index, "name", None)
    if name is not None and str(name) not in columns:
        header, columns = (str(name), *header), {str(name): np.asarray(index), **columns}
    _require_once(header, source)
    if not columns or not len(columns[header[0]]):
        raise LogError(f"{source}: no rows, expected at least two of numbers")
    numbers = {k: np.asarray(v, dtype=np.float64) for k, v in columns.items() if v.dtype.kind in "fiub"}
    times = frozenset(k for k, v in columns.items() if v.dtype.kind == "M")
    for k in times:
        since = columns[k] - columns[k][0]
        numbers[k] = np.where(np.isnat(since), np.nan, since / np.timedelta64(1, "s"))
    for k, v in columns.items():  # a column with gaps may hold objects
        if v.dtype.kind == "O":
            with suppress(TypeError, ValueError):
                numbers[k] = np.array([np.nan if cell is None else cell for cell in v], dtype=np.float64)
    texts = {k: tuple(map(str, v)) for k, v in columns.items() if k not in numbers}
    return Table(source, header, numbers, texts, times)


def text_table(lines: Sequence[str], source: str, wanted: Iterable[str] = (), names: Sequence[str] = ()) -> Table:
    """Columns of delimited text, wherever in it the table lies; see `grid_of_lines`.

    A last line that has no line end and too few cells was cut off while it was written: it is left out. A column that
    holds both numbers and texts is left to `texts`, with a fault.

    Args:
        lines: of the file; one of them is not blank.
        source: its path, for messages.
        wanted: names of columns that a layout knows.
        names: of the columns, where no row of the file names them.

    Raises:
        LogError: on a column named twice, no rows or a ragged row.
    """
    grid = grid_of_lines(lines, source, wanted)
    header = tuple(names) or grid.header or _numbered(len(cells_of(lines[grid.start], grid.delimiter)))
    _require_once(header, f"{source}, row {grid.header_row + 1}")
    stop = grid.stop
    if grid.start < stop == len(lines) and _is_unfinished(lines[-1], grid.delimiter, len(header)):
        stop -= 1

    @cache
    def rows() -> list[Row]:
        return _checked(_rows(lines[:stop], grid, source), header, source)

    block = _fast(lines[grid.start : stop], grid.delimiter, len(header))
    if block is None:
        kept = rows()
        found = convert(_columns(kept, len(header)), grid.delimiter != ",") if kept else []
    else:
        found = [Converted("number", np.ascontiguousarray(column)) for column in block.T]
        kept = []
    return _table(source, grid, header, found, kept, rows, bool(names) or bool(grid.header))


def sheet_table(rows: Sequence[Sequence[str]], source: str, wanted: Iterable[str] = ()) -> Table:
    """Columns of rows of cells, such as those of a sheet; see `text_table`.

    Raises:
        LogError: on a column named twice, no rows or a ragged row.
    """
    grid = grid_of_cells(rows, source, wanted)
    width = max((len(row) for row in rows[grid.start : grid.stop]), default=0)
    header = grid.header or _numbered(width)
    _require_once(header, f"{source}, row {grid.header_row + 1}")
    short = ((k + 1, rows[k]) for k in range(grid.start, grid.stop) if any(rows[k]))
    kept = _checked(((k, [*row, *[""] * (len(header) - len(row))]) for k, row in short), header, source)
    found = convert(_columns(kept, len(header)), comma_likely=True) if kept else []
    return _table(source, grid, header, found, kept, lambda: kept, bool(grid.header))


def read_table(lines: Sequence[str], source: str) -> Table:
    """Columns of a text that this package wrote; every column that begins with a number holds nothing else.

    Raises:
        LogError: see `text_table`; also on text among numbers, named by row and column.
    """
    table = text_table(lines, source)
    for name in table.faults:
        raise table.not_numbers(name)
    empty = {name: k for k, name in enumerate(table.header) if name in table.numbers and _is_empty(table.numbers[name])}
    rows = table.rows() if table.rows is not None and empty else ()
    cells = {name: tuple(row[k].strip() for _, row in rows) for name, k in empty.items()}
    words = {name: own for name, own in cells.items() if not {*map(str.lower, own)} <= {"", "nan", "-nan"}}
    numbers = {name: values for name, values in table.numbers.items() if name not in words}
    return replace(table, numbers=numbers, texts={**table.texts, **words})  # `-` is a word of this package's own


def _is_empty(values: Vec) -> bool:
    return bool(np.isnan(values).all())


def _table(
    source: str,
    grid: Grid,
    header: tuple[str, ...],
    found: Sequence[Converted],
    kept: Sequence[Row],
    rows: Callable[[], Sequence[Row]],
    named: bool,
) -> Table:
    if not found:
        raise LogError(f"{source}: header only, expected at least two rows of numbers")
    columns = dict(zip(header, found, strict=True))
    whole = {name: c.values for name, c in columns.items() if c.values is not None and c.fault is None}
    texts = {name: tuple(row[k].strip() for _, row in kept) for k, name in enumerate(header) if name not in whole}
    faults = {name: c.fault for name, c in columns.items() if c.fault is not None and c.kind != "text"}
    times = frozenset(name for name, c in columns.items() if c.kind == "time")
    units = dict(zip(header, grid.units, strict=False))
    return Table(source, header, whole, texts, times, units, named, grid.header_row + 1, faults, rows)


def _numbered(width: int) -> tuple[str, ...]:
    return tuple(f"[{k}]" for k in range(width))


def _require_once(header: Sequence[str], where: str) -> None:
    counts = Counter(header)
    if twice := sorted(name for name, count in counts.items() if name and count > 1):
        raise LogError(f"{where}: column {shown(twice[0])} occurs twice, expected each once")


def _rows(lines: Sequence[str], grid: Grid, source: str) -> Iterable[Row]:
    """Every row of data that is neither blank nor a comment."""
    if grid.delimiter == BLANK or not any('"' in line for line in lines[grid.start :]):
        for k in range(grid.start, len(lines)):
            cells = cells_of(lines[k], grid.delimiter)
            if any(cells) and not _is_comment(cells):
                yield k + 1, cells
        return
    reader = csv.reader((line + "\n" for line in lines[grid.start :]), delimiter=grid.delimiter)
    try:
        for raw in reader:
            cells = [cell.strip() for cell in raw]
            if any(cells) and not _is_comment(cells):
                yield grid.start + reader.line_num, cells
    except csv.Error as error:  # a quote that is never closed
        raise LogError(f"{source}, row {grid.start + reader.line_num}: {error}, expected delimited text") from None


def _is_comment(cells: Sequence[str]) -> bool:
    return cells[0].startswith(_COMMENTS) and not is_value(cells[0])


def _checked(rows: Iterable[Row], header: Sequence[str], source: str) -> list[Row]:
    """The rows, all as wide as the header; further cells that are empty fall away."""
    kept, width = [], len(header)
    for number, cells in rows:
        if len(cells) != width and (len(cells) < width or any(cells[width:])):
            raise LogError(f"{source}, row {number}: {len(cells)} cells, expected {width} as in the header")
        kept.append((number, cells[:width]))
    return kept


def _columns(rows: Sequence[Row], width: int) -> list[list[str]]:
    return [[cells[k] for _, cells in rows] for k in range(width)]


def _is_unfinished(line: str, delimiter: str, width: int) -> bool:
    """Whether the last line, which has no line end, was cut off before its last cell."""
    return bool(line.strip()) and len(cells_of(line, delimiter)) < width


def _fast(lines: Sequence[str], delimiter: str, width: int) -> Vec | None:
    """All cells as numbers, (T, width), or None where anything is unusual and must be read cell by cell."""
    if delimiter != BLANK and {line.count(delimiter) for line in lines if line} != {width - 1}:
        return None
    if delimiter != "," and any("," in line for line in lines):
        if any("." in line for line in lines):
            return None
        lines = [line.replace(",", ".") for line in lines]
    try:
        block = np.loadtxt(lines, delimiter=None if delimiter == BLANK else delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    return block if block.shape[1] == width and len(block) else None

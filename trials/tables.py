"""Tables: named columns of delimited text, of sheets and of data frames; errors name the row and column of a cell."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Protocol, runtime_checkable

import numpy as np

from .cells import MISSING, Converted, convert, is_value
from .errors import LogError, shown
from .formats import seconds_since_first
from .types import Vec

BLANK = " "
"""Delimiter of cells separated by one or several blanks."""

MOST_COLUMNS = 4096

_DELIMITERS = (",", ";", "\t", "|", BLANK)
_SAMPLE, _LETTERS = 400, 200_000  # greatest number of rows and characters used to detect the layout
_COMMENTS = ("#", "%", "//")
_UNIT_WORDS = """
s sec secs second seconds ms msec us usec ns min h hour hours d day days hz khz mm um nm cm m in inch deg rad ° degree
degrees bar mbar kpa pa mpa psi v mv kv volt volts a ma n mn kn nmm k c °c degc celsius percent % rpm g kg n*m n·m deg/s
°/s rad/s mm/s m/s m/s^2 count counts steps pulse pulses ticks lsb adu 1 - none float double int bool string text unit
units
"""
_UNITS = frozenset(_UNIT_WORDS.split())
_DECLARED = re.compile("sep=([^ ])", re.IGNORECASE)  # the first line of a file of Excel


@dataclass(frozen=True)
class Grid:
    """Location of a table among rows of text or of a sheet."""

    delimiter: str  # of the cells; empty if they are separate already
    header: tuple[str, ...]
    header_row: int  # index of the header, or of the first row of data
    units: tuple[str, ...]  # cells of the row of units below the header; empty if there is none
    start: int
    stop: int


def cells_of(line: str, delimiter: str) -> list[str]:
    """Cells of one row of text, stripped."""
    if not line:
        return []
    if delimiter == BLANK and '"' not in line:
        return line.split()
    if '"' in line:
        try:
            cells = [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
            return [cell for cell in cells if cell] if delimiter == BLANK else cells
        except csv.Error:  # a cell beyond the length limit
            return [line]
    return [cell.strip() for cell in line.split(delimiter)]


def grid_of_lines(lines: Sequence[str], source: str, wanted: Iterable[str] = ()) -> Grid:
    """Locate the table in lines of text, one of which is not blank.

    The delimiter is the one with the greatest share of cells that hold a number, a date or a time.

    Raises:
        LogError: if there are no rows, or more columns than the limit.
    """
    sample: list[int] = []
    letters = 0
    for k, line in enumerate(lines):
        if line.strip():
            letters += len(line)
            if sample and (letters > _LETTERS or len(sample) > _SAMPLE):
                break
            sample.append(k)
    if letters > _LETTERS and len(sample) == 1:
        raise LogError(
            f"{source}, row {sample[0] + 1}: {len(lines[sample[0]])} characters in one row, expected delimited text"
        )
    declared = _DECLARED.fullmatch(lines[sample[0]].strip("\r\n ").strip('"'))
    if declared:
        del sample[0]
    if not sample:
        raise LogError(f"{source}: no rows, expected a header row and at least two rows of numbers")
    choices = {}
    for delimiter in (declared[1],) if declared else _DELIMITERS:
        choices[delimiter] = _judge([_judged(cells_of(_uncommented(lines[k]), delimiter)) for k in sample])
    delimiter = max(choices, key=lambda d: (choices[d][0], d != BLANK, choices[d][1]))
    purity, width = choices[delimiter]
    if not purity and not declared:  # names alone
        names = lines[sample[0]]
        delimiter = max(_DELIMITERS[:-1], key=names.count)
        delimiter = delimiter if delimiter in names or len(names.split()) < 2 else BLANK
    return _located(lambda k: cells_of(lines[k], delimiter), sample, len(lines), delimiter, width, source, wanted)


def grid_of_cells(rows: Sequence[Sequence[str]], source: str, wanted: Iterable[str] = ()) -> Grid:
    """Locate the table among rows of cells, such as those of a sheet; see `grid_of_lines`.

    Raises:
        LogError: if all are empty, or there are more columns than the limit.
    """
    sample = [k for k, row in enumerate(rows) if any(row)][:_SAMPLE]
    if not sample:
        raise LogError(f"{source}: empty, expected a header row and at least two rows of numbers")
    _, width = _judge([_judged(rows[k]) for k in sample])
    return _located(lambda k: list(rows[k]), sample, len(rows), "", width, source, wanted)


def _uncommented(line: str) -> str:
    for mark in _COMMENTS:
        if line.lstrip().startswith(mark):
            return line.lstrip().lstrip(mark[0]).lstrip(" ")
    return line


def _judged(cells: Sequence[str]) -> tuple[int, int, int]:
    """Counts of a row: cells, cells with a value, other nonempty cells."""
    known = [cell for cell in cells if cell.lower() not in MISSING]
    values = sum(map(is_value, known))
    return len(cells), values, len(known) - values


def _is_data(judged: tuple[int, int, int]) -> bool:
    return judged[1] > judged[2]


def _judge(rows: Sequence[tuple[int, int, int]]) -> tuple[float, int]:
    """Share of value cells in the data rows of the most frequent width, and this width; nearly zero for one column."""
    data = [row for row in rows if _is_data(row)]
    counts = Counter(row[0] for row in data)
    if not counts:
        return 0.0, 0
    width = max(counts, key=lambda w: (counts[w], w))
    fitting = [row for row in data if row[0] == width]
    values, others = sum(row[1] for row in fitting), sum(row[2] for row in fitting)
    return (values / (values + others) * len(fitting) / len(data) if width > 1 else 1e-6), width


def _located(
    cells: Callable[[int], list[str]],
    sample: Sequence[int],
    count: int,
    delimiter: str,
    width: int,
    source: str,
    wanted: Iterable[str],
) -> Grid:
    judged = {k: _judged(cells(k)) for k in sample}
    data = next((k for k in sample if judged[k][0] == width and _is_data(judged[k])), None)
    if data is None:  # names alone, or cells of which none is a number
        header = _names(cells(sample[0]), delimiter)
        if not header:
            raise LogError(f"{source}: no name and no number in any row, expected a header and rows of numbers")
        _require_width(header, source, sample[0])
        return Grid(delimiter, header, sample[0], (), sample[0] + 1, count)
    known = {name.casefold() for name in wanted}
    above = [k for k in sample if k < data]
    names = {k: _names(cells(k), delimiter) for k in above}
    names = {k: row for k, row in names.items() if len(row) > 1 and not _is_data(_judged(row))}
    hits = {k: sum(name.casefold() in known for name in row) for k, row in names.items()}
    narrow = width - 1 if not any(cells(k)[-1] for k in sample if k >= data and judged[k][0] == width) else width
    names = {k: row for k, row in names.items() if narrow <= len(row) <= width or hits[k]}
    head = max(names, key=lambda k: (hits[k], not _are_units(names[k]), len(names[k]) == width, k), default=None)
    if head is None:
        _require_width(cells(data), source, data)
        return Grid(delimiter, (), data, (), data, _end(cells, data, count))
    below = [k for k in above if k > head]
    units = next((k for k in below if _are_units(cells(k))), None)
    start = next((k for k in below if judged[k][1] and k != units), data)
    _require_width(names[head], source, head)
    unit_cells = names.get(units, ()) if units is not None else ()
    return Grid(delimiter, names[head], head, unit_cells, start, _end(cells, start, count))


def _names(cells: list[str], delimiter: str) -> tuple[str, ...]:
    first = _uncommented(cells[0]).strip() if cells else ""
    names = [first, *cells[1:]] if first or delimiter != BLANK else cells[1:]
    while names and not names[-1]:
        names = names[:-1]
    return tuple(names)


def _are_units(cells: Iterable[str]) -> bool:
    known = [cell.strip("[](){}<> ").replace("µ", "u").replace("μ", "u").lower() for cell in cells]
    return all(cell in _UNITS for cell in known if cell)


def _end(cells: Callable[[int], list[str]], start: int, count: int) -> int:
    """End of the data rows; rows without a value at the end of a file are comments."""
    stop = count
    while stop > start + 1 and not any(map(is_value, cells(stop - 1))):
        stop -= 1
    return stop


def _require_width(cells: Sequence[str], source: str, row: int) -> None:
    if len(cells) > MOST_COLUMNS:
        raise LogError(f"{source}, row {row + 1}: {len(cells)} cells, expected at most {MOST_COLUMNS}")


Row = tuple[int, Sequence[str]]  # its number, counted from 1 as an editor shows it, and its cells


@dataclass(frozen=True, eq=False)
class LogTable:
    """Columns of one file or data frame.

    In `numbers` empty cells and marks of missing values are not-a-number. `faults` has, for a column that mixes numbers
    and other cells, the first such sample and an addition to its error.
    """

    source: str
    header: tuple[str, ...]  # all columns in the order of the file; `[0]`, `[1]`, ... without a header row
    numbers: Mapping[str, Vec]  # columns of numbers, each (T,)
    texts: Mapping[str, tuple[str, ...]]  # other columns, each of length T
    times: frozenset[str] = frozenset()  # columns of `numbers` that were dates or times; seconds since the first
    units: Mapping[str, str] = field(default_factory=dict)  # entries of a row of units below the header
    named: bool = True
    header_row: int = 1  # counted from 1
    faults: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    rows: Callable[[], Sequence[Row]] | None = None  # rereads the rows for messages; None for a data frame

    def locate(self, sample: int, column: str) -> tuple[int, str]:
        """Row and text of one cell; rows of a file count from 1, as in an editor, of a data frame from 0."""
        if self.rows is None:
            return sample, str(self.texts[column][sample] if column in self.texts else self.numbers[column][sample])
        number, cells = self.rows()[sample]
        return number, cells[self.header.index(column)].strip()

    def renamed(self, header: tuple[str, ...]) -> LogTable:
        """Copy of the table with new column names, in order."""
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
        """Note on unused columns in which text follows numbers; empty if there are none."""
        faults = {name: fault[0] for name, fault in self.faults.items() if name not in asked}
        if not faults:
            return ""
        name, sample = next(iter(faults.items()))
        row, cell = self.locate(sample, name)
        more = f" and {len(faults) - 1} more" if len(faults) > 1 else ""
        return f"column {shown(name, 40)}{more} left out: row {row} holds {shown(cell, 40)}, no number"

    def not_numbers(self, column: str) -> LogError:
        """Error for a column of `texts` that is needed as numbers."""
        sample, why = self.faults.get(column, (0, ""))
        row, cell = self.locate(sample, column)
        expected = f"expected a number{f'; {why}' if why else ''}"
        return LogError(f"{self.source}, row {row}, column {column!r}: got {shown(cell, 60)}, {expected}")


@runtime_checkable
class FrameLike(Protocol):
    """Named columns in memory, such as a pandas or polars `DataFrame`; neither package is imported."""

    @property
    def columns(self) -> Any:
        """Names of the columns, in order."""
        ...

    def __getitem__(self, name: Any, /) -> Any:
        """Column as `numpy.asarray` accepts it."""
        ...


def frame_table(frame: FrameLike) -> LogTable:
    """Columns of a data frame; an index that has a name is a column too, and dates are seconds since the first.

    Raises:
        LogError: if a name occurs twice, or there is no row.
    """
    header, source = tuple(map(str, frame.columns)), "<frame>"
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
        numbers[k] = seconds_since_first(columns[k])
    for k, v in columns.items():  # a column with gaps may hold objects
        if v.dtype.kind == "O":
            with suppress(TypeError, ValueError):
                numbers[k] = np.array([np.nan if cell is None else cell for cell in v], dtype=np.float64)
    texts = {k: tuple(map(str, v)) for k, v in columns.items() if k not in numbers}
    return LogTable(source, header, numbers, texts, times)


def text_table(lines: Sequence[str], source: str, wanted: Iterable[str] = ()) -> LogTable:
    """Columns of delimited text with the table at any position; see `grid_of_lines`.

    A last line without line end and with too few cells was cut off while it was written: it is left out. A column with
    both numbers and texts is stored in `texts`, with a fault.
    """
    grid = grid_of_lines(lines, source, wanted)
    header = grid.header or _numbered(len(cells_of(lines[grid.start], grid.delimiter)))
    _require_once(header, f"{source}, row {grid.header_row + 1}")
    stop = grid.stop
    last = lines[-1]
    if grid.start < stop == len(lines) and last.strip() and len(cells_of(last, grid.delimiter)) < len(header):
        stop -= 1

    @cache
    def rows() -> list[Row]:
        return _checked(_rows(lines[:stop], grid, source), header, source)

    block = _fast(lines[grid.start : stop], grid.delimiter, len(header))
    if block is None:
        kept = rows()
        converted = _converted(kept, len(header), grid.delimiter != ",")
    else:
        converted = [Converted("number", np.ascontiguousarray(column)) for column in block.T]
        kept = []
    return _table(source, grid, header, converted, kept, rows)


def sheet_table(rows: Sequence[Sequence[str]], source: str, wanted: Iterable[str] = ()) -> LogTable:
    """Columns of rows of cells, such as those of a sheet; errors as of `text_table`."""
    grid = grid_of_cells(rows, source, wanted)
    width = max((len(row) for row in rows[grid.start : grid.stop]), default=0)
    header = grid.header or _numbered(width)
    _require_once(header, f"{source}, row {grid.header_row + 1}")
    short = ((k + 1, rows[k]) for k in range(grid.start, grid.stop) if any(rows[k]))
    kept = _checked(((k, [*row, *[""] * (len(header) - len(row))]) for k, row in short), header, source)
    converted = _converted(kept, len(header), comma_likely=True)
    return _table(source, grid, header, converted, kept, lambda: kept)


def read_table(lines: Sequence[str], source: str) -> LogTable:
    """Columns of a text written by this package, in which a column is all numbers or all text.

    Raises:
        LogError: see `text_table`; also on text among numbers, named by row and column.
    """
    table = text_table(lines, source)
    for name in table.faults:
        raise table.not_numbers(name)
    empty = {n: k for k, n in enumerate(table.header) if n in table.numbers and np.isnan(table.numbers[n]).all()}
    rows = table.rows() if table.rows is not None and empty else ()
    cells = {name: tuple(row[k].strip() for _, row in rows) for name, k in empty.items()}
    words = {name: texts for name, texts in cells.items() if not {*map(str.lower, texts)} <= {"", "nan", "-nan"}}
    numbers = {name: values for name, values in table.numbers.items() if name not in words}
    return replace(table, numbers=numbers, texts={**table.texts, **words})  # `-` is a word of this package's own


def _table(
    source: str,
    grid: Grid,
    header: tuple[str, ...],
    converted: Sequence[Converted],
    kept: Sequence[Row],
    rows: Callable[[], Sequence[Row]],
) -> LogTable:
    if not converted:
        raise LogError(f"{source}: header only, expected at least two rows of numbers")
    columns = dict(zip(header, converted, strict=True))
    whole = {name: c.values for name, c in columns.items() if c.values is not None and c.fault is None}
    texts = {name: tuple(row[k].strip() for _, row in kept) for k, name in enumerate(header) if name not in whole}
    faults = {name: c.fault for name, c in columns.items() if c.fault is not None and c.kind != "text"}
    times = frozenset(name for name, c in columns.items() if c.kind == "time")
    units = dict(zip(header, grid.units, strict=False))
    return LogTable(source, header, whole, texts, times, units, bool(grid.header), grid.header_row + 1, faults, rows)


def _numbered(width: int) -> tuple[str, ...]:
    return tuple(f"[{k}]" for k in range(width))


def _require_once(header: Sequence[str], where: str) -> None:
    counts = Counter(header)
    if twice := sorted(name for name, count in counts.items() if name and count > 1):
        raise LogError(f"{where}: column {shown(twice[0])} occurs twice, expected each once")


def _rows(lines: Sequence[str], grid: Grid, source: str) -> Iterable[Row]:
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
    kept, width = [], len(header)
    for number, cells in rows:
        if len(cells) != width and (len(cells) < width or any(cells[width:])):
            raise LogError(f"{source}, row {number}: {len(cells)} cells, expected {width} as in the header")
        kept.append((number, cells[:width]))
    return kept


def _converted(rows: Sequence[Row], width: int, comma_likely: bool) -> list[Converted]:
    return convert([[cells[k] for _, cells in rows] for k in range(width)], comma_likely) if rows else []


def _fast(lines: Sequence[str], delimiter: str, width: int) -> Vec | None:
    """Fast conversion of all cells to numbers (T, width); None without any, or if a cell needs separate conversion."""
    if not any(lines):
        return None
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

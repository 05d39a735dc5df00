"""Where the table lies in a text or a sheet: delimiter, header row, and rows above and below that are none of it."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from .cells import MISSING, is_value
from .errors import LogError

BLANK = " "
"""The delimiter of cells that one or several blanks separate."""

MOST_COLUMNS = 4096

_DELIMITERS = (",", ";", "\t", "|", BLANK)
_SAMPLE, _LETTERS = 400, 200_000  # most rows, and letters in all, that tell the layout
_COMMENTS = ("#", "%", "//")
_UNIT_WORDS = """
s sec secs second seconds ms msec us usec ns min h hour hours d day days hz khz mm um nm cm m in inch deg rad ° degree
degrees bar mbar kpa pa mpa psi v mv kv volt volts a ma n mn kn nmm k c °c degc celsius percent % rpm g kg n*m n·m deg/s
°/s rad/s mm/s m/s m/s^2 count counts steps pulse pulses ticks lsb adu 1 - none float double int bool string text unit
units
"""
_UNITS = frozenset(_UNIT_WORDS.split())


@dataclass(frozen=True)
class Grid:
    """A table among rows.

    Attributes:
        delimiter: of the cells; empty where they are apart already.
        header: names of the columns; empty where no row names them.
        header_row: index of the row that holds them, or of the first row of data.
        units: cells of the row of units below the header; empty where there is none.
        start, stop: rows of data, by index.
    """

    delimiter: str
    header: tuple[str, ...]
    header_row: int
    units: tuple[str, ...]
    start: int
    stop: int


def cells_of(line: str, delimiter: str) -> list[str]:
    """The cells of one row of text, stripped."""
    if not line:
        return []
    if delimiter == BLANK and '"' not in line:
        return line.split()
    if '"' in line:
        try:
            cells = [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
            return [cell for cell in cells if cell] if delimiter == BLANK else cells
        except csv.Error:  # a cell longer than any
            return [line]
    return [cell.strip() for cell in line.split(delimiter)]


def grid_of_lines(lines: Sequence[str], source: str, wanted: Iterable[str] = ()) -> Grid:
    """Find the table in lines of text, one of which is not blank.

    The delimiter is the one that leaves the greatest share of cells with a number, a date or a time.

    Args:
        lines: of the file.
        source: its path, for messages.
        wanted: names of columns that a layout knows.

    Raises:
        LogError: if there are no rows, or more columns than in any log.
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
    if told := _told(lines[sample[0]]):
        del sample[0]
    if not sample:
        raise LogError(f"{source}: no rows, expected a header row and at least two rows of numbers")
    choices = {}
    for delimiter in (told,) if told else _DELIMITERS:
        choices[delimiter] = _judge([_judged(cells_of(_uncommented(lines[k]), delimiter)) for k in sample])
    delimiter = max(choices, key=lambda d: (choices[d][0], d != BLANK, choices[d][1]))
    purity, width = choices[delimiter]
    if not purity:
        delimiter = told or _of_header(lines[sample[0]])
    return _located(lambda k: cells_of(lines[k], delimiter), sample, len(lines), delimiter, width, source, wanted)


def grid_of_cells(rows: Sequence[Sequence[str]], source: str, wanted: Iterable[str] = ()) -> Grid:
    """Find the table among rows of cells, such as those of a sheet; see `grid_of_lines`.

    Raises:
        LogError: if all are empty, or there are more columns than in any log.
    """
    sample = [k for k, row in enumerate(rows) if any(row)][:_SAMPLE]
    if not sample:
        raise LogError(f"{source}: empty, expected a header row and at least two rows of numbers")
    _, width = _judge([_judged(rows[k]) for k in sample])
    return _located(lambda k: list(rows[k]), sample, len(rows), "", width, source, wanted)


def _told(line: str) -> str:
    """The delimiter that the first line of a file of Excel names: `sep=;`."""
    text = line.strip("\r\n ").strip('"')
    return text[4:5] if text[:4].lower() == "sep=" and len(text) <= 5 and text[4:5].strip(" ") else ""


def _of_header(line: str) -> str:
    """The delimiter of a row of names."""
    delimiter = max(_DELIMITERS[:-1], key=line.count)
    return delimiter if delimiter in line or len(line.split()) < 2 else BLANK


def _uncommented(line: str) -> str:
    """A row without the mark of a comment at its beginning."""
    for mark in _COMMENTS:
        if line.lstrip().startswith(mark):
            return line.lstrip().lstrip(mark[0]).lstrip(" ")
    return line


def _judged(cells: Sequence[str]) -> tuple[int, int, int]:
    """How many cells a row has, how many hold a value, how many hold anything else."""
    known = [cell for cell in cells if cell.lower() not in MISSING]
    values = sum(map(is_value, known))
    return len(cells), values, len(known) - values


def _is_data(judged: tuple[int, int, int]) -> bool:
    return judged[1] > judged[2]


def _judge(rows: Sequence[tuple[int, int, int]]) -> tuple[float, int]:
    """Share of cells that hold a value, in rows of data of one width, and this width; nearly zero for one column."""
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
    """Header, units, and first and last row of data."""
    judged = {k: _judged(cells(k)) for k in sample}
    data = next((k for k in sample if judged[k][0] == width and _is_data(judged[k])), None)
    if data is None:  # names alone, or cells of which none is a number
        header = tuple(_trimmed(_named(cells(sample[0]), delimiter)))
        if not header:
            raise LogError(f"{source}: no name and no number in any row, expected a header and rows of numbers")
        _require_width(header, source, sample[0])
        return Grid(delimiter, header, sample[0], (), sample[0] + 1, count)
    known = {name.casefold() for name in wanted}
    above = [k for k in sample if k < data]
    names = {k: tuple(_trimmed(_named(cells(k), delimiter))) for k in above}
    names = {k: found for k, found in names.items() if len(found) > 1 and not _is_data(_judged(found))}
    hits = {k: sum(name.casefold() in known for name in found) for k, found in names.items()}
    narrow = width - 1 if not any(cells(k)[-1] for k in sample if k >= data and judged[k][0] == width) else width
    names = {k: found for k, found in names.items() if narrow <= len(found) <= width or hits[k]}
    head = max(names, key=lambda k: (hits[k], not _are_units(names[k]), len(names[k]) == width, k), default=None)
    if head is None:
        _require_width(cells(data), source, data)
        return Grid(delimiter, (), data, (), data, _end(cells, data, count))
    below = [k for k in above if k > head]
    units = next((k for k in below if _are_units(cells(k))), None)
    start = next((k for k in below if judged[k][1] and k != units), data)
    _require_width(names[head], source, head)
    told = names.get(units, ()) if units is not None else ()
    return Grid(delimiter, names[head], head, told, start, _end(cells, start, count))


def _named(cells: list[str], delimiter: str) -> list[str]:
    """The cells of a row of names, without the mark of a comment."""
    first = _uncommented(cells[0]).strip() if cells else ""
    return [first, *cells[1:]] if first or delimiter != BLANK else cells[1:]


def _trimmed(cells: list[str]) -> list[str]:
    """Without the empty cells at the end, which a trailing delimiter makes."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _are_units(cells: Iterable[str]) -> bool:
    known = [cell.strip("[](){}<> ").replace("µ", "u").replace("μ", "u").lower() for cell in cells]
    return all(cell in _UNITS for cell in known if cell)


def _end(cells: Callable[[int], list[str]], start: int, count: int) -> int:
    """The end of the rows of data: rows without any value at the end of a file are remarks."""
    stop = count
    while stop > start + 1 and not any(map(is_value, cells(stop - 1))):
        stop -= 1
    return stop


def _require_width(cells: Sequence[str], source: str, row: int) -> None:
    if len(cells) > MOST_COLUMNS:
        raise LogError(f"{source}, row {row + 1}: {len(cells)} cells, expected at most {MOST_COLUMNS}")

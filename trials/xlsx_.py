"""Sheets of Excel workbooks (.xlsx) as tables; no code of a workbook runs, and its unpacked size is bounded."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Iterable, Sequence
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from .errors import LogError, require
from .formats import reading
from .tables import MOST_COLUMNS, LogTable, sheet_table

MOST_BYTES = 1 << 28
"""Greatest unpacked size of a workbook; a million rows of four columns have half of it."""

_MOST_PARTS, _MOST_ROWS, _MOST_SHEETS = 2000, 1_048_576, 50
_MOST_CELLS = 20_000_000
_MOST_EMPTY = 10_000  # rows between others; a sheet of one cell far down would have a million
_BLOCK = 1 << 20
_DOCTYPE = b"<!doctype"
_UTF_16 = (b"<\0", b"\0<", b"\xff\xfe", b"\xfe\xff")


def open_xlsx(path: Path | str, wanted: Iterable[str] = ()) -> LogTable:
    """Read the sheet of a workbook with most of the wanted names, otherwise the first one with a table.

    Formulas have their values at the time of saving; dates and times of day are seconds since the first.

    Raises:
        LogError: if `openpyxl` is not installed, the file is no workbook, unpacks to more than `MOST_BYTES`, or no
            sheet holds a table.
    """
    require("openpyxl", "logs", f"{path}: reading Excel workbooks")
    with reading(path, "Excel workbook"):
        sheets = _sheets(path)
    names, tables, faults = frozenset(name.casefold() for name in wanted), [], []
    for title, rows in sheets:
        try:
            tables.append(sheet_table(rows, str(path), names))
        except LogError as error:
            faults.append(f"sheet {title[:31]!r}: {str(error).removeprefix(f'{path}')[:150].lstrip(', :')}")
    if not tables:
        raise LogError(f"{path}: {faults[0] if faults else 'no sheet with cells'}")
    return max(tables, key=lambda table: sum(name.casefold() in names for name in table.header))


def _sheets(path: Path | str) -> list[tuple[str, list[list[str]]]]:
    from openpyxl import load_workbook

    _require_bounded(path)
    sheets, left = [], _MOST_CELLS
    with warnings.catch_warnings(), Path(path).open("rb") as file:  # for a path the library would require an ending
        warnings.simplefilter("ignore")  # on ignored styles and extensions
        book = load_workbook(file, read_only=True, data_only=True, keep_links=False)
        try:
            for sheet in book.worksheets[:_MOST_SHEETS]:
                sheet.reset_dimensions()  # stored dimensions are often wrong
                rows: list[list[str]] = []
                filled = 0
                for row in sheet.iter_rows(max_row=_MOST_ROWS, values_only=True):
                    cells = _texts(row)
                    filled = len(rows) if cells else filled
                    if len(rows) - filled > _MOST_EMPTY:
                        break
                    left -= len(cells) + 1
                    if left < 0 or len(cells) > MOST_COLUMNS:
                        raise LogError(f"{path}: more cells than in any log, expected one trial; save it as CSV")
                    rows.append(cells)
                sheets.append((str(sheet.title), rows))
        finally:
            book.close()
    return sheets


def _texts(row: Sequence[Any]) -> list[str]:
    last = len(row)
    while last and row[last - 1] is None:
        last -= 1
    return [_text(value) for value in row[:last]]


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    if isinstance(value, datetime):
        return value.isoformat(" ")
    if isinstance(value, date | time):
        return value.isoformat()
    return repr(value) if isinstance(value, float | int) else str(value).strip()


def _require_bounded(path: Path | str) -> None:
    """Refuse a workbook with a too large unpacked size, or whose XML defines entities."""
    with zipfile.ZipFile(path) as archive:
        parts = archive.infolist()
        size = sum(part.file_size for part in parts)
        if len(parts) > _MOST_PARTS or size > MOST_BYTES:
            raise LogError(f"{path}: unpacks to {size} bytes in {len(parts)} parts, more than a log; save it as CSV")
        for part in parts:
            with archive.open(part) as file:  # never unpacks to more than its size above
                _require_plain(path, part.filename, file)


def _require_plain(path: Path | str, name: str, file: Any) -> None:
    tail = b""
    while block := file.read(_BLOCK):
        if not tail and block.startswith(_UTF_16):
            raise LogError(f"{path}: {name[:60]!r} is not in UTF-8, expected a workbook as Excel writes it")
        if _DOCTYPE in (tail + block).lower():
            raise LogError(f"{path}: {name[:60]!r} defines entities, expected a workbook as Excel writes it")
        tail = block[-len(_DOCTYPE) :]

"""Columns of a sweep's table in memory, and tables as CSV where pyarrow is not installed.

Floats are written so that they come back to the last bit.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

Column = Vec | list[str | None]
ENDING = ".csv"
_MARKS = {"number": ":number", "whole": ":whole", "text": ""}


def as_column(values: Sequence[Any], kind: str) -> Column:
    """Numbers as an array (N,), NaN where there is none; texts as they are."""
    if kind == "text":
        return [None if value is None else str(value) for value in values]
    return np.array([math.nan if value is None else float(value) for value in values], dtype=np.float64)


def numbers(table: Mapping[str, Column], name: str) -> Vec:
    """A column of numbers (N,)."""
    return np.asarray(table[name], dtype=np.float64)


def texts(table: Mapping[str, Column], name: str) -> list[str]:
    """A column as texts, numbers to six digits, empty ones as nothing."""
    return [
        "" if value is None else value if isinstance(value, str) else f"{float(value):.6g}" for value in table[name]
    ]


def chosen(table: Mapping[str, Column], rows: NDArray[np.bool_]) -> dict[str, Column]:
    """Some rows of a table.

    Args:
        table: columns (N,).
        rows: which, (N,).
    """
    where = np.flatnonzero(rows)
    return {name: c[where] if isinstance(c, np.ndarray) else [c[k] for k in where] for name, c in table.items()}


def write(path: Path, rows: Iterable[Mapping[str, Any]], kinds: Mapping[str, str]) -> None:
    """Write rows, whole or not at all; the header says which columns are numbers."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow([name + _MARKS[kind] for name, kind in kinds.items()])
    for row in rows:
        table.writerow(["" if (value := row.get(name)) is None else _text(value) for name in kinds])
    write_atomically(path, out.getvalue())


def read(path: Path, names: Iterable[str]) -> dict[str, Column]:
    """Some columns of a file; one that it lacks is empty."""
    header, rows = _rows(path)
    place = {name: k for k, (name, _) in enumerate(header)}
    found: dict[str, Column] = {}
    for name in names:
        if name not in place:
            found[name] = as_column([None] * len(rows), "text")
            continue
        found[name] = as_column([row[place[name]] or None for row in rows], header[place[name]][1])
    return found


def kinds(path: Path) -> dict[str, str]:
    """Kinds of the columns of a file."""
    return dict(_rows(path)[0])


def merge(target: Path, parts: Sequence[tuple[Path, Sequence[int]]], columns: Mapping[str, str]) -> None:
    """Write chosen rows of several files as one, whole or not at all."""

    def rows() -> Iterable[dict[str, str]]:
        for path, chosen in parts:
            header, lines = _rows(path)
            for k in chosen:
                yield {name: text for (name, _), text in zip(header, lines[k], strict=True) if text}

    write(target, rows(), columns)


def _rows(path: Path) -> tuple[list[tuple[str, str]], list[list[str]]]:
    """Name and kind of every column, and the lines."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)
    return [_named(text) for text in header], lines


def _named(text: str) -> tuple[str, str]:
    name, _, kind = text.rpartition(":")
    return (name, kind) if name and kind in ("number", "whole") else (text, "text")


def _text(value: Any) -> str:
    return repr(value) if isinstance(value, float) else str(value)

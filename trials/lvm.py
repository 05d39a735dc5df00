"""LabVIEW measurement files (.lvm): text with a header of keys, and columns over `X_Value`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from .errors import LogError
from .tables import Table, sheet_table
from .types import Vec

_START = "LabVIEW Measurement"
_END = "***End_of_Header***"
X_VALUE, _COMMENT = "X_Value", "Comment"
_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";", "space": " "}


def is_lvm(lines: Sequence[str]) -> bool:
    """Whether the text is a LabVIEW measurement."""
    return lines[0].lstrip("\ufeff").startswith(_START)


def lvm_table(lines: Sequence[str], source: str) -> Table:
    """Columns of a measurement; `X_Value` is in seconds, computed from `X0` and `Delta_X` if it is empty.

    Raises:
        LogError: if a header is cut off, channels have times of their own, or there are no rows.
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
    """Keys of a header in small letters, and their values; of several channels one each."""
    rows = [[cell.strip() for cell in line.split(separator)] for line in lines]
    return {row[0].lower(): [cell for cell in row[1:] if cell] or [""] for row in rows if row and row[0]}


def _blocks(
    lines: Sequence[str], ends: Sequence[int], separator: str
) -> Iterator[tuple[Mapping[str, list[str]], list[str], list[list[str]]]]:
    """Header, names of the columns and rows of every part of a file."""
    for number, end in enumerate(ends):
        begin = ends[number - 1] + 1 if number else 0
        stop = ends[number + 1] if number + 1 < len(ends) else len(lines)
        body = [[cell.strip() for cell in line.split(separator)] for line in lines[end + 1 : stop]]
        head = next((k for k, row in enumerate(body) if row[0] == X_VALUE), None)
        if head is None:
            continue
        rows = []
        for row in body[head + 1 :]:
            if row[0].lower() in ("channels", _START.lower()):  # the header of the next part
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

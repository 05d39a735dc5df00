"""Conversion of text cells to numbers: decimal point or comma, thousands separators, dates and times of day."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date
from itertools import pairwise

import numpy as np

from .types import Vec

MISSING = frozenset(
    ("", "nan", "-nan", "na", "n/a", "#n/a", "#nv", "null", "none", "nil", "-", "--", "---", "inval", "missing")
)
"""Marks of a missing value in a cell, in lower case."""

_POWER = r"(?:[eE][-+]?\d+)?"
_GROUP = "[ \u00a0\u202f'\u2019]"  # marks of thousands that are no decimal mark


def _form(decimal: str, group: str) -> re.Pattern[str]:
    """Pattern of numbers with a decimal mark, and with `group` or a neutral character as thousands separator."""
    parted = rf"\d{{1,3}}(?:{group}\d{{3}})+|\d{{1,3}}(?:{_GROUP}\d{{3}})+"
    return re.compile(rf"[-+]?(?:(?:\d+|{parted})(?:{decimal}\d*)?|{decimal}\d+){_POWER}")


_POINT, _COMMA = _form(r"\.", ","), _form(",", r"\.")
_LONGEST_NUMBER = 400  # letters; the greatest float has 309 digits
_SPECIAL = re.compile(r"[-+]?(?:nan|inf|infinity)", re.IGNORECASE)
_EITHER = re.compile(r"[-+]?(\d*)([.,])(\d*)([eE][-+]?\d+)?")  # one mark only
_GROUPS = re.compile(_GROUP)
_MINUS = "\u2212"  # the minus sign of typesetting
_NUMBER_STARTS = frozenset("+-.,0123456789nNiI" + _MINUS)

_STAMP = re.compile(
    r"""(?:(?:[a-z]{3,9},?\s+)?                                       # Monday,
        (?P<a>\d{1,4}|[a-z]{3,9})(?P<s>[-/.\s])\s?(?P<b>\d{1,2}|[a-z]{3,9})(?:(?P=s)|,)\s?(?P<c>\d{2,4})[T,;\s_]*)?
        (?:(?P<h>\d{1,3}):(?P<m>\d{1,2})(?::(?P<sec>\d{1,2}))?(?:[.,:](?P<part>\d{1,12}))?)?
        \s*(?P<half>[ap]\.?m\.?)?\s*(?P<zone>Z|UTC|GMT|[-+]\d{2}:?\d{2}|[-+]\d{2})?""",
    re.IGNORECASE | re.VERBOSE,
)
_LONGEST_STAMP = 48
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DAY_S, _HOUR_S = 86_400, 3_600


@dataclass(frozen=True, eq=False)
class Converted:
    """One column of a table after conversion to numbers, if possible."""

    kind: str  # `number`, `time` [s since the first stamp], or `text`
    values: Vec | None  # (T,), not-a-number for an empty cell; None for a text
    fault: tuple[int, str] | None = None  # first cell of another kind, and the reason; None if there is none


def is_value(cell: str) -> bool:
    """Whether a cell holds a number, a date or a time, and no mark for a missing value."""
    return bool(cell) and (_number_like(cell) or _stamp(cell) is not None)


def _number_like(cell: str) -> bool:
    if not cell or len(cell) > _LONGEST_NUMBER or cell[0] not in _NUMBER_STARTS:
        return False
    text = cell.replace(_MINUS, "-")
    return bool(_POINT.fullmatch(text) or _COMMA.fullmatch(text) or _SPECIAL.fullmatch(text))


def convert(columns: Sequence[Sequence[str]], comma_likely: bool) -> list[Converted]:
    """Convert every column of a table; a decimal mark that is certain in one column holds for all of them.

    With `comma_likely` an ambiguous comma is a decimal mark, as in cells separated by semicolons.
    """
    plain = [_floats(cells) for cells in columns]
    if all(values is not None or not any("," in cell for cell in c) for values, c in zip(plain, columns, strict=True)):
        marks: list[set[str]] = [set() for _ in columns]
    else:
        marks = [_marks(cells) for cells in columns]
    sure = [kinds & {".", ","} for kinds in marks]
    known = set[str]().union(*sure)
    common = next(iter(known)) if len(known) == 1 else ""
    converted = []
    for cells, values, kinds, certain in zip(columns, plain, marks, sure, strict=True):
        if values is not None and (common != "," or kinds != {"?."}):
            converted.append(Converted("number", values))
        else:
            mark = next(iter(certain)) if len(certain) == 1 else common
            if mark == "." and kinds == {"?,"} and all("," in cell for cell in cells if cell.lower() not in MISSING):
                mark = "?"  # 1,234 and 5,678 beside numbers with points: of three digits each, not of thousands alone
            converted.append(_column(cells, mark, comma_likely))
    return converted


def _floats(cells: Sequence[str]) -> Vec | None:
    if any("_" in cell for cell in cells):  # Python reads 1_0 as 10, which a log does not mean
        return None
    try:
        return np.array([float(cell) if cell else math.nan for cell in cells])
    except ValueError:
        return None


def _marks(cells: Iterable[str]) -> set[str]:
    """Possible decimal marks of a column: `.` or `,` if certain, `?.` or `?,` if it may separate thousands."""
    marks = set()
    for cell in cells:
        if ("." in cell or "," in cell) and _number_like(cell):
            marks.add(_mark(cell))
            if marks & {".", ","}:  # contradicting cells are detected when the column is read
                break
    return marks


def _mark(cell: str) -> str:
    points, commas = cell.count("."), cell.count(",")
    if points and commas:
        return "." if cell.rfind(".") > cell.rfind(",") else ","
    if points + commas > 1:
        return "," if points else "."
    one = _EITHER.fullmatch(cell.replace(_MINUS, "-"))
    if one is None:  # thousands separated by a space or an apostrophe
        return "." if points else ","
    before, mark, after, power = one.groups()
    sure = len(after) != 3 or not 1 <= len(before) <= 3 or before.startswith("0") or power
    return mark if sure else f"?{mark}"


def _column(cells: Sequence[str], mark: str, comma_likely: bool) -> Converted:
    first = next((cell for cell in cells if cell.lower() not in MISSING), None)
    if first is None:
        return Converted("number", np.full(len(cells), math.nan))
    if _number_like(first):
        return _numbers(cells, mark, comma_likely)
    return _times(cells) if _stamp(first) is not None else Converted("text", None, (cells.index(first), ""))


def _numbers(cells: Sequence[str], mark: str, comma_likely: bool) -> Converted:
    whole = _floats([cell.replace(",", ".") for cell in cells]) if mark == "," and "." not in "".join(cells) else None
    if whole is not None:
        return Converted("number", whole)
    values, fault = np.full(len(cells), math.nan), None
    decimal = mark or ("," if comma_likely else "?")
    form, group = (_COMMA, ".") if decimal == "," else (_POINT, ",")
    for k, cell in enumerate(cells):
        if cell.lower() in MISSING:
            continue
        text, why = cell.replace(_MINUS, "-"), ""
        if _SPECIAL.fullmatch(text):
            values[k] = float(text)
            continue
        one = _EITHER.fullmatch(text)
        if one and decimal in ("?", ",") and one[2] == ("," if decimal == "?" else "."):
            why = f"{one[2]!r} may be the decimal mark or part thousands; write numbers with a decimal point"
        if why or not form.fullmatch(text):
            fault = fault or (k, why)
            continue
        values[k] = float(_GROUPS.sub("", text.replace(group, "")).replace(",", "."))
    return Converted("number", values, fault)


def _stamp(cell: str) -> re.Match[str] | None:
    """Match a cell with a date, a time of day, or both."""
    if len(cell) > _LONGEST_STAMP or (":" not in cell and cell.count("-") + cell.count("/") + cell.count(".") < 2):
        return None
    stamp = _STAMP.fullmatch(cell)
    return stamp if stamp and (stamp["a"] or stamp["h"]) and (stamp["h"] or not stamp["part"]) else None


def _times(cells: Sequence[str]) -> Converted:
    """Convert dates and times of day to seconds since the first; without a date, a fall in time is midnight."""
    stamps = [None if cell.lower() in MISSING else _stamp(cell) for cell in cells]
    known, rows = [k for k, stamp in enumerate(stamps) if stamp is not None], [s for s in stamps if s is not None]
    fault = next(((k, "") for k, cell in enumerate(cells) if stamps[k] is None and cell.lower() not in MISSING), None)
    days, wrong = _days(rows)
    minutes_first = all(s["h"] and not s["sec"] and not s["a"] for s in rows) and any(s["part"] for s in rows)
    unit = 60 if minutes_first else _HOUR_S  # 00:01.5 is a minute and a half second
    values = np.full(len(cells), math.nan)
    if wrong is not None:
        return Converted("time", values, (known[wrong], "no such date"))
    turn = None if any(s["a"] for s in rows) else (60 if minutes_first else 24) * unit
    values[known] = _since_first(days, [_second(stamp, unit) for stamp in rows], turn)
    return Converted("time", values, fault)


def _second(stamp: re.Match[str], unit: int) -> tuple[int, int]:
    """Time of day in UTC: whole seconds and nanoseconds."""
    hour, minute, second = (int(stamp[name] or 0) for name in ("h", "m", "sec"))
    if half := stamp["half"]:
        hour = hour % 12 + (12 if half[0] in "pP" else 0)
    nano = int((stamp["part"] or "0").ljust(9, "0")[:9])
    zone = stamp["zone"] or ""
    ahead = 0
    if zone[:1] in ("+", "-"):
        digits = zone[1:].replace(":", "").ljust(4, "0")
        ahead = (1 if zone[0] == "+" else -1) * (int(digits[:2]) * 3600 + int(digits[2:]) * 60)
    return hour * unit + minute * (unit // 60) + second - ahead, nano


def _since_first(days: Sequence[int], seconds: Sequence[tuple[int, int]], turn: int | None) -> Vec:
    """Time stamps [s] from the first one on, computed in integers so that no digit is lost."""
    if not seconds:
        return np.zeros(0)
    whole = np.array([day * _DAY_S + second for day, (second, _) in zip(days, seconds, strict=True)], dtype=np.int64)
    if turn is not None:
        whole = whole + turn * np.cumsum(np.diff(whole, prepend=whole[0]) < -turn // 2)
    nano = np.array([nano for _, nano in seconds], dtype=np.int64)
    total = (whole - whole[0]) * 1_000_000_000 + (nano - nano[0])
    return total / 1e9


def _days(stamps: Sequence[re.Match[str]]) -> tuple[list[int], int | None]:
    """Day number of every stamp (zero without a date), and the index of the first impossible date."""
    triples = [(s["a"], s["b"], s["c"]) for s in stamps]
    different = set(triples)
    by_order = {order: {triple: _day(triple, order) for triple in different} for order in ("ymd", "dmy", "mdy")}
    fitting = [days for days in by_order.values() if None not in days.values()]
    if not fitting:
        wrong = {triple for triple in different if all(days[triple] is None for days in by_order.values())}
        return [], next((k for k, triple in enumerate(triples) if triple in wrong), 0)
    # 03/04 is 3 April or 4 March: if all else is ambiguous, consecutive days must be close to each other.
    choices = [[days[triple] or 0 for triple in triples] for days in fitting]
    return min(choices, key=_spread), None


def _spread(days: Sequence[int]) -> float:
    in_order = all(one <= following for one, following in pairwise(days))
    return float(max(days) - min(days)) if in_order else math.inf


def _day(triple: tuple[str | None, ...], order: str) -> int | None:
    """Day number of year, month and day in one order; None if the date does not exist."""
    a, b, c = (part or "" for part in triple)
    if not a:
        return 0
    parts = dict(zip(order, (a, b, c), strict=True))
    month = parts["m"][:3].lower()
    number = _MONTHS.index(month) + 1 if month in _MONTHS else int(month) if month.isdigit() else 0
    year = parts["y"]
    if not (parts["d"].isdigit() and len(parts["d"]) <= 2 and year.isdigit() and len(year) in (2, 4)):
        return None
    if order == "ymd" and len(year) != 4:
        return None
    try:
        return date(int(year) + (2000 if len(year) == 2 else 0), number, int(parts["d"])).toordinal()
    except ValueError:
        return None

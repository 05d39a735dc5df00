"""A benchmark as rows of text."""

from __future__ import annotations

from .report import Reads, Report, Row

COLUMNS = ("measured", "median", "p99", "against", "median", "ratio", "goal", "note")
_DASH = "-"
_DISTURBED = 1.3


def table_rows(report: Report) -> list[list[str]]:
    """One list of texts a row, in the order of `COLUMNS`; what is measured is named in its first row."""
    rows, before = [], ""
    for row in report.rows:
        name = f"{row.section}: {row.ours}"
        rows.append([name, *_own(row)] if name != before else ["", "", ""])
        rows[-1] += _against(row)
        before = name
    return rows


def _own(row: Row) -> list[str]:
    return [_duration(row.times.median_s), _duration(row.times.p99_s)] if row.times else [_DASH, _DASH]


def _against(row: Row) -> list[str]:
    other_s = row.limit_s if row.limit_s is not None else row.other_times.median_s if row.other_times else None
    ratio = row.state if row.ratio is None else f"{_ratio(row.ratio)} {row.reads}"
    note = "; ".join(filter(None, (_disturbed(row), row.note)))
    return [row.other, _duration(other_s), ratio, _goal(row), note]


def _disturbed(row: Row) -> str:
    """The ratio of the shortest calls where it is far from that of the medians: other work has taken part."""
    least = row.least_ratio
    if row.ratio is None or least is None or 1 / _DISTURBED < row.ratio / least < _DISTURBED:
        return ""
    return f"{_ratio(least)} by the shortest calls"


def _goal(row: Row) -> str:
    if row.goal is None:
        return _DASH
    sign = "≥" if row.reads is Reads.FASTER else "≤"
    verdict = {None: "", True: " yes", False: " no"}[row.reached]
    return f"{sign} {row.goal:.3g}{verdict}"


def _ratio(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def _duration(seconds: float | None) -> str:
    """With a unit that fits: 173 us, 2.31 ms, 1.20 s."""
    if seconds is None:
        return _DASH
    if seconds < 1e-3:
        return f"{1e6 * seconds:.3g} us"
    return f"{1e3 * seconds:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"

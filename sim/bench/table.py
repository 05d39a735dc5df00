"""A benchmark as rows of text."""

from __future__ import annotations

from .report import Reads, Report, Row

COLUMNS = ("section", "ours", "against", "median", "p99", "against, median", "ratio", "", "goal", "note")
_DASH = "-"


def table_rows(report: Report) -> list[list[str]]:
    """One list of texts a row, in the order of `COLUMNS`; a section is named in its first row."""
    rows, before = [], ""
    for row in report.rows:
        rows.append([row.section if row.section != before else "", *_cells(row)])
        before = row.section
    return rows


def _cells(row: Row) -> list[str]:
    median = _duration(row.times.median_s if row.times else None)
    p99 = _duration(row.times.p99_s if row.times else None)
    other_s = row.limit_s if row.limit_s is not None else row.other_times.median_s if row.other_times else None
    ratio = row.state if row.ratio is None else _ratio(row.ratio)
    return [row.ours, row.other, median, p99, _duration(other_s), ratio, str(row.reads), _goal(row), row.note]


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
    scale, unit = next((s, u) for s, u in ((1.0, "s"), (1e-3, "ms"), (0.0, "us")) if seconds >= s)
    return f"{seconds / (scale or 1e-6):.3g} {unit}"

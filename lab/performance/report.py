"""Result of a benchmark: rows of one ratio each, as JSON and as a table of text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from .subjects import Times

FORMAT = "hystmpc-bench/1"
COLUMNS = ("measured", "median", "p99", "against", "median", "ratio", "goal", "note")
_DASH = "-"
_DISTURBED = 1.3


class Reads(StrEnum):
    """Meaning of a ratio."""

    FASTER = "x faster"  # peer / ours
    OVER_LIMIT = "x limit"
    TAIL = "p99/median"  # of ours


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of one quantity with a peer or a limit.

    Attributes:
        goal: of the ratio: at least for `FASTER`, at most for the others; None for none.
        state: `measured`, `not installed`, `interrupted`.
        times, other_times: of both sides; the limit has a duration only.
        limit_s: duration at the limit [s].
    """

    section: str
    ours: str
    other: str
    reads: Reads
    goal: float | None = None
    state: str = "interrupted"
    ratio: float | None = None
    times: Times | None = None
    other_times: Times | None = None
    limit_s: float | None = None
    facts: Mapping[str, float] = field(default_factory=dict)
    note: str = ""

    def with_times(self, ours: Times | None, other: Times | None) -> Comparison:
        """Row with the available times of both sides."""
        return replace(self, times=ours, other_times=other)

    def measured(self, ratio: float, **more: Any) -> Comparison:
        """Row with its ratio, and values for further fields."""
        return replace(self, ratio=ratio, state="measured", **more)

    def without_peer(self) -> Comparison:
        """Row of a peer that is not installed."""
        return replace(self, state="not installed")

    @property
    def least_ratio(self) -> float | None:
        """Ratio of the shortest calls, which other load on the machine hardly disturbs; None without one."""
        if self.ratio is None or self.times is None or self.reads is Reads.TAIL:
            return None
        if self.limit_s is not None:
            return self.times.least_s / self.limit_s
        return self.other_times.least_s / self.times.least_s if self.other_times else None

    @property
    def reached(self) -> bool | None:
        """Whether the goal is reached, by the medians and by the shortest calls; None without goal or ratio.

        On a busy machine the medians alone may flatter: a peer whose threads wait for each other is stalled by others.
        """
        if self.goal is None or self.ratio is None:
            return None
        ratios = [ratio for ratio in (self.ratio, self.least_ratio) if ratio is not None]
        return all(r >= self.goal if self.reads is Reads.FASTER else r <= self.goal for r in ratios)


@dataclass(frozen=True, eq=False)
class Growth:
    """Growth of a step's time with one size.

    Attributes:
        size: that is changed, `H`, `N` or `hidden`.
        values: of it, ascending (K,).
        times: of a step at each (K,).
        goal: greatest exponent; None for none.
    """

    what: str
    size: str
    values: tuple[int, ...]
    times: tuple[Times, ...]
    goal: float | None = None

    @property
    def exponent(self) -> float:
        """Exponent p of time ~ size^p between the two greatest sizes, by the shortest calls, against disturbances."""
        (a, b), (s, t) = self.values[-2:], (times.least_s for times in self.times[-2:])
        return math.log(t / s) / math.log(b / a)

    @property
    def reached(self) -> bool | None:
        """Whether the goal is reached; None without one."""
        return None if self.goal is None else self.exponent <= self.goal


@dataclass(frozen=True, eq=False)
class BenchReport:
    """Report of a whole run."""

    settings: Mapping[str, Any]
    machine: Mapping[str, Any]
    models: Mapping[str, str]
    rows: Sequence[Comparison]
    interrupted: bool
    growth: Sequence[Growth] = ()


def report_json(report: BenchReport) -> dict[str, Any]:
    """Plain data in format `hystmpc-bench/1`; durations in seconds."""
    return {
        "format": FORMAT,
        "settings": dict(report.settings),
        "machine": dict(report.machine),
        "models": dict(report.models),
        "interrupted": report.interrupted,
        "rows": [_row_json(row) for row in report.rows],
        "growth": [_growth_json(one) for one in report.growth],
    }


def _row_json(row: Comparison) -> dict[str, Any]:
    other = {"name": row.other, **_times_json(row.other_times)}
    if row.limit_s is not None:
        other["median_s"] = row.limit_s
    return {
        "section": row.section,
        "ours": {"name": row.ours, **_times_json(row.times)},
        "other": other,
        "ratio": row.ratio,
        "least_ratio": row.least_ratio,
        "reads": str(row.reads),
        "goal": row.goal,
        "reached": row.reached,
        "state": row.state,
        "facts": dict(row.facts),
        "note": row.note,
    }


def _growth_json(growth: Growth) -> dict[str, Any]:
    points = [{"size": v, **_times_json(t)} for v, t in zip(growth.values, growth.times, strict=True)]
    return {
        "what": growth.what,
        "size": growth.size,
        "points": points,
        "exponent": growth.exponent,
        "goal": growth.goal,
        "reached": growth.reached,
    }


def _times_json(times: Times | None) -> dict[str, Any]:
    if times is None:
        return {}
    return {"median_s": times.median_s, "p99_s": times.p99_s, "least_s": times.least_s, "calls": times.seconds.size}


def table_rows(report: BenchReport) -> list[list[str]]:
    """Rows of text in the order of `COLUMNS`; the measured quantity is named only in its first row."""
    rows, before = [], ""
    for row in report.rows:
        name = f"{row.section}: {row.ours}"
        rows.append([name, *_own(row)] if name != before else ["", "", ""])
        rows[-1] += _against(row)
        before = name
    return rows


def _own(row: Comparison) -> list[str]:
    return [_duration(row.times.median_s), _duration(row.times.p99_s)] if row.times else [_DASH, _DASH]


def _against(row: Comparison) -> list[str]:
    other_s = row.limit_s if row.limit_s is not None else row.other_times.median_s if row.other_times else None
    ratio = row.state if row.ratio is None else f"{_ratio(row.ratio)} {row.reads}"
    note = "; ".join(filter(None, (_disturbed(row), row.note)))
    return [row.other, _duration(other_s), ratio, _goal(row), note]


def _disturbed(row: Comparison) -> str:
    """Ratio of the shortest calls if it differs much from that of the medians, a sign of other load."""
    least = row.least_ratio
    if row.ratio is None or least is None or 1 / _DISTURBED < row.ratio / least < _DISTURBED:
        return ""
    return f"{_ratio(least)} by the shortest calls"


def _goal(row: Comparison) -> str:
    if row.goal is None:
        return _DASH
    sign = "≥" if row.reads is Reads.FASTER else "≤"
    verdict = {None: "", True: " yes", False: " no"}[row.reached]
    return f"{sign} {row.goal:.3g}{verdict}"


def _ratio(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def _duration(seconds: float | None) -> str:
    """Duration with a suitable unit: 173 us, 2.31 ms, 1.20 s."""
    if seconds is None:
        return _DASH
    if seconds < 1e-3:
        return f"{1e6 * seconds:.3g} us"
    return f"{1e3 * seconds:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"

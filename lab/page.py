"""Bars, tables and pages of the studies: requirements with their violations, CSV and HTML."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

import numpy as np

from hystmpc.trials.files import write_atomically
from hystmpc.trials.json_text import plain
from hystmpc.trials.report import REFERENCE, Heading, KeyValues, Paragraph, Piece, Table, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Plotted

Cell = str | int | float
NOTHING = "-"
Figures = Mapping[str, float]
_NAMED = 6  # devices that a bar names
_MARKS = "os^v"
_QUICK_NOTE = "QUICK: the numbers below show that everything runs, and say nothing about the controllers."
_T = TypeVar("_T")


def plain_result(result: Any) -> dict[str, Any]:
    """Result as JSON; a number that is not finite is null."""
    return dict(plain(asdict(result)))


@dataclass(frozen=True)
class Rate:
    """Share of cases."""

    hits: int
    cases: int

    @property
    def value(self) -> float:
        """Share as a number; not-a-number without cases."""
        return self.hits / self.cases if self.cases else float("nan")

    @property
    def ci90(self) -> tuple[float, float]:
        """Wilson's 90 % interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
        from scipy.stats import binomtest  # slow to import

        if not self.cases:
            return 0.0, 1.0
        interval = binomtest(self.hits, self.cases).proportion_ci(0.9, method="wilson")
        # Rounding may put an end past the rate itself where that is 0 or 1.
        return min(float(interval.low), self.value), max(float(interval.high), self.value)


@dataclass(frozen=True)
class Bar:
    """Requirement: a number, its bounds, and the violating cases.

    Attributes:
        value: the number; not-a-number without a relevant case.
        wanted: `lower` and `upper` bound.
    """

    name: str
    value: float
    wanted: tuple[float, float]
    cases: int
    misses: tuple[str, ...] = ()
    ci90: tuple[float, float] | None = None

    @property
    def state(self) -> Literal["met", "missed", "not measured"]:
        """Whether the number is within its bounds."""
        if not self.cases or np.isnan(self.value):
            return "not measured"
        return "met" if self.wanted[0] <= self.value <= self.wanted[1] else "missed"

    @property
    def goal(self) -> str:
        """Bounds in words."""
        low, high = self.wanted
        if low <= 0:
            return f"<= {high:g}" if high > 0 else "0"
        return f">= {low:g}" if high >= 1 > low else "1" if low >= 1 else f"{low:g} to {high:g}"

    @property
    def plain(self) -> dict[str, Any]:
        """Bar as JSON; a number that is not finite is null."""
        return {**plain(asdict(self)), "state": self.state}

    @classmethod
    def at_most(
        cls, name: str, values: Figures, limit: float, level: float = 1.0, misses: tuple[str, ...] | None = None
    ) -> Self:
        """Bar on an order statistic of figures by device: the share `level` is no greater; 1 for the maximum.

        Args:
            values: infinite for a device that was lost.
            misses: devices against the bar; those beyond the limit where left out.
        """
        ranked = np.sort(np.array(list(values.values())))
        value = float(ranked[math.ceil(level * ranked.size) - 1])
        return cls(name, value, (0.0, limit), ranked.size, beyond(values, limit) if misses is None else misses)

    @classmethod
    def share(cls, name: str, hits: Mapping[str, bool], wanted: tuple[float, float], counted: bool = False) -> Self:
        """Bar on the share of devices that hit; the others violate it or, if `counted`, those that hit."""
        rate = Rate(sum(hits.values()), len(hits))
        misses = tuple(name for name, hit in hits.items() if bool(hit) is counted)
        return cls(name, rate.value, wanted, len(hits), misses, rate.ci90)

    @classmethod
    def none(cls, name: str, totals: Figures) -> Self:
        """Bar on a total over devices that has to be 0."""
        return cls(name, sum(totals.values()), (0.0, 0.0), len(totals), tuple(k for k, n in totals.items() if n))


def beyond(values: Figures, limit: float) -> tuple[str, ...]:
    """Devices with a figure above a limit, or not a number."""
    return tuple(name for name, value in values.items() if not value <= limit)


def rmse_of(figures: Figures, controller: str) -> float:
    """RMSE of a controller over all motions [deg]; infinite if it is missing."""
    return figures.get(f"{controller}.rmse_deg", math.inf)


def over(controller: str, *others: str) -> Callable[[Figures], float]:
    """RMSE of a controller divided by the least of others; infinite if one of them is missing."""

    def ratio(figures: Figures) -> float:
        a, b = rmse_of(figures, controller), min(rmse_of(figures, other) for other in others)
        return a / b if math.isfinite(a) and b > 0 else math.inf

    return ratio


def by_device(devices: Mapping[str, Figures], figure: Callable[[Figures], _T]) -> dict[str, _T]:
    """Figure of every device by name."""
    return {name: figure(figures) for name, figures in devices.items()}


@dataclass(frozen=True)
class StudyTable:
    """Rows of one table; floats are displayed with four digits and written in full.

    Attributes:
        caption: what it shows, and whether its numbers are simulated, real or printed in a paper.
    """

    name: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str
    shown: bool = True

    @property
    def piece(self) -> Table:
        """Table as a piece of the report."""
        return Table(self.columns, self.rows, f"{self.caption} ({self.name}.csv)")

    @property
    def csv(self) -> str:
        """Table as comma-separated text."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.rows)
        return out.getvalue()

    def save(self, folder: Path) -> Path:
        """Write `tables/<name>.csv` below the study's folder."""
        return write_atomically(folder / "tables" / f"{self.name}.csv", self.csv)

    def only(self, caption: str, *columns: str) -> StudyTable:
        """Same table with some of the columns."""
        places = [list(self.columns).index(name) for name in columns]
        return StudyTable(self.name, columns, [[row[k] for k in places] for row in self.rows], caption)


def cell(value: float) -> Cell:
    """Table cell of a figure; a dash for a missing one."""
    return value if math.isfinite(value) else NOTHING if math.isnan(value) else "infinite"


def bars_table(judged: Sequence[Bar]) -> StudyTable:
    """Table of every bar with its number and goal."""
    rows: list[list[Cell]] = []
    for bar in judged:
        interval = NOTHING if bar.ci90 is None else f"{bar.ci90[0]:.2f} to {bar.ci90[1]:.2f}"
        more = f" and {len(bar.misses) - _NAMED} more" if len(bar.misses) > _NAMED else ""
        named = ", ".join(bar.misses[:_NAMED]) + more
        rows.append([bar.name, cell(bar.value), interval, bar.goal, bar.cases, bar.state, named or NOTHING])
    columns = ("bar", "number", "90 % interval", "goal", "devices", "state", "devices beyond it")
    return StudyTable("bars", columns, rows, "Simulated: the bars.")


def judged_by(bars: Callable[[Any], Sequence[Bar]], results: str) -> dict[str, Any]:
    """Fields `data` and `summary` of a study that is judged by bars.

    Args:
        results: name of the list of results in `tables/NAME.json`.
    """
    return {"data": partial(_bars_data, bars, results), "summary": partial(_bars_summary, bars)}


def _bars_data(bars: Callable[[Any], Sequence[Bar]], results: str, outcome: Any) -> dict[str, Any]:
    return {"bars": [bar.plain for bar in bars(outcome)], results: [plain_result(r) for r in outcome.results]}


def _bars_summary(bars: Callable[[Any], Sequence[Bar]], outcome: Any) -> StudyTable:
    return bars_table(bars(outcome)).only("Bars", "bar", "number", "goal", "devices", "state")


def figures_table(devices: Mapping[str, Figures]) -> StudyTable:
    """Table of every figure of every device, for CSV only."""
    rows: list[list[Cell]] = [
        [name, k, cell(value)] for name, figures in devices.items() for k, value in figures.items()
    ]
    return StudyTable("figures", ("device", "figure", "value"), rows, "", shown=False)


def set_up(about: str, facts: Mapping[str, object], outcome: Any, note: str | None = None) -> Iterator[Piece]:
    """Head of a page: work done, settings, and failures.

    Args:
        about: the study in some sentences; may be empty.
        facts: rows of this study, before those that all studies have.
        note: sentence below the settings; that of a quick run where left out.
    """
    settings, results, failed = outcome.settings, outcome.results, outcome.failed
    yield Heading("Set-up")
    if about:
        yield Paragraph(about)
    yield KeyValues(
        {
            **facts,
            "jobs": f"{len(results) - len(failed)} done, {len(failed)} failed",
            "seed": settings.seed,
            "processor time of all jobs": f"{sum(r.seconds for r in results) / 60:.1f} min",
            "hystmpc": outcome.meta.get("versions", {}).get("hystmpc"),
            "started": outcome.meta.get("start"),
        }
    )
    if note := (_QUICK_NOTE if settings.quick else "") if note is None else note:
        yield Paragraph(note)
    for result in failed:
        yield Paragraph(f"FAILED: {result.job.key}: {result.message}")


def ratios_figure(families: Mapping[str, Sequence[Sequence[float]]], subjects: Sequence[tuple[str, str]]) -> Plotted:
    """Plot of the RMSE divided by that of the better tuned rival, a panel for each family, sorted by first subject.

    Args:
        families: a row for each device of the family, with a ratio for each subject.
        subjects: label and colour of each.
    """
    with new_figure(7.0, 3.0) as figure:
        panels = figure.subplots(1, len(families), sharey=True, squeeze=False)[0]
        for axes, (family, devices) in zip(panels, families.items(), strict=True):
            ratios = np.array(sorted(devices, key=lambda row: row[0])).reshape(-1, len(subjects))
            for y, (label, colour), mark in zip(ratios.T, subjects, _MARKS, strict=False):
                axes.plot(np.arange(y.size), y, mark, color=colour, markersize=3.5, label=label, linestyle="none")
            axes.axhline(1.0, color=REFERENCE, linewidth=0.8)
            axes.axhline(0.5, color=REFERENCE, linewidth=0.6, linestyle="--")
            axes.set(title=family, xticks=[], yscale="log")
        panels[0].set_ylabel("RMSE over the best tuned PID's")
        figure.supxlabel("devices, sorted", fontsize=9.0)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure

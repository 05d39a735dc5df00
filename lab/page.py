"""What the pages of studies have in common: the set-up at their head, the bars, errors over those of tuned rivals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure

from hystmpc.trials.report import REFERENCE, Heading, KeyValues, Paragraph, Piece, new_figure

from .blind.bars import Bar
from .tables import NOTHING, Cell, StudyTable

_SHOWN = 6  # devices that a bar names
_MARKS = "os^v"


class PageOutcome(Protocol):
    """What a study of many jobs has come to."""

    @property
    def settings(self) -> Any:
        """With `seed` and `quick`."""
        ...

    @property
    def results(self) -> Sequence[Any]:
        """Of all jobs, each with `job.key`, `message` and `seconds`."""
        ...

    @property
    def failed(self) -> Sequence[Any]:
        """Those that hold an error."""
        ...

    @property
    def meta(self) -> Mapping[str, Any]:
        """Of the run folder."""
        ...


def set_up(about: str, facts: Mapping[str, object], outcome: PageOutcome) -> Iterator[Piece]:
    """The head of a page: what was done, its settings, and what failed.

    Args:
        about: the study in some sentences.
        facts: rows of its own, before those that all studies have.
    """
    settings, results, failed = outcome.settings, outcome.results, outcome.failed
    yield Heading("Set-up")
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
    if settings.quick:
        yield Paragraph("QUICK: the numbers below show that everything runs, and say nothing about the controllers.")
    for result in failed:
        yield Paragraph(f"FAILED: {result.job.key}: {result.message}")


def cell(value: float) -> Cell:
    """A figure in a table; one that is not there is a dash."""
    return value if math.isfinite(value) else NOTHING if math.isnan(value) else "infinite"


def bars_table(judged: Sequence[Bar]) -> StudyTable:
    """Every bar with its number and goal."""
    rows: list[list[Cell]] = []
    for bar in judged:
        interval = NOTHING if bar.ci90 is None else f"{bar.ci90[0]:.2f} to {bar.ci90[1]:.2f}"
        more = f" and {len(bar.misses) - _SHOWN} more" if len(bar.misses) > _SHOWN else ""
        named = ", ".join(bar.misses[:_SHOWN]) + more
        rows.append([bar.name, cell(bar.value), interval, bar.goal, bar.cases, bar.state, named or NOTHING])
    columns = ("bar", "number", "90 % interval", "goal", "devices", "state", "devices beyond it")
    return StudyTable("bars", columns, rows, "Simulated: the bars.")


def ratios_figure(families: Mapping[str, Sequence[Sequence[float]]], subjects: Sequence[tuple[str, str]]) -> Figure:
    """RMSE over that of the better tuned rival, a panel for each family, its devices sorted by the first subject.

    Args:
        families: a row for each device of the family, with a ratio for each subject.
        subjects: label and colour of each.
    """
    with new_figure(7.0, 3.0) as figure:
        panels = figure.subplots(1, len(families), sharey=True)
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

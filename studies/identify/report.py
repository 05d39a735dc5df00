"""The report of the identification study: tables, figure, page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure

from hystmpc.trials.report import (
    MEASURED,
    MODEL,
    PALETTE,
    REFERENCE,
    Heading,
    KeyValues,
    Paragraph,
    Piece,
    Plot,
    Report,
    new_figure,
)

from ..blind.bars import Bar
from ..tables import NOTHING, Cell, StudyTable
from .bars import CONTROLLERS, PARTS, TUNED, IdentifyOutcome, at_rest, bars, over, over_best, rmse, summary
from .device import FAMILIES
from .job import IdentifyResult

_ABOUT = """Simulated devices drawn at random: a core (rod, capstan, Dahl, muscle) behind a drive with delay, lag or
servo, and creep, with a noisy sensor. A model is identified from three minutes of logs. The predictive controllers have
default settings. The gains of PID and of inverse with PID are searched on the very device and motions under another
realisation of the noise: the strongest opponents of their kind, not forecasts. "exact" is the default controller with
the device itself as its model. Every RMSE is of the true angle over three fresh motions without their approaches."""
_SHOWN = 6  # devices that a bar names
_MARKS = "os^v"


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


def families_table(outcome: IdentifyOutcome) -> StudyTable:
    """Medians by family."""
    rows: list[list[Cell]] = []
    for family in (*FAMILIES, None):
        found = summary(outcome, family)
        rows.append([family or "all", *(cell(value) for value in found.values())])
    return StudyTable(
        "families", ("family", *summary(outcome)), rows, "Simulated: medians over the devices of a family."
    )


def devices_table(outcome: IdentifyOutcome) -> StudyTable:
    """A row for each device: what was drawn, what was found, and the errors of all controllers."""
    rows: list[list[Cell]] = []
    for r in outcome.done:
        parts: list[Cell] = [cell for part in PARTS for cell in (round(r.truth[part], 4), _interval(r, part))]
        errors: list[Cell] = [cell(rmse(r, name)) for name in CONTROLLERS]
        ratios = (
            over_best(r),
            over("linearised", "exact")(r),
            over("as_identified_linearised", "as_identified_inverse")(r),
        )
        facts: list[Cell] = [round(float(r.facts["noise_deg"]), 3), round(float(r.facts["servo_damping"]), 2)]
        rows.append([r.job.key, *facts, *parts, *errors, *map(cell, ratios), cell(at_rest(r)), round(r.seconds, 1)])
    drawn = [name for part in PARTS for name in (part, f"{part} found")]
    columns = ("device", "noise [deg]", "servo damping", *drawn, *(f"{name} [deg]" for name in CONTROLLERS))
    last = ("over best tuned", "over exact", "as identified", "at rest", "time [s]")
    return StudyTable("devices", (*columns, *last), rows, "Simulated: every device; errors are RMSE of the true angle.")


def runs_table(outcome: IdentifyOutcome) -> StudyTable:
    """Every figure of every device; CSV only."""
    rows: list[list[Cell]] = [[r.job.key, name, cell(value)] for r in outcome.done for name, value in r.figures.items()]
    return StudyTable("figures", ("device", "figure", "value"), rows, "", shown=False)


def _interval(result: IdentifyResult, part: str) -> str:
    if part not in result.found:
        return NOTHING
    value, low, high = result.found[part]
    return f"{value:.3g} ({low:.3g} to {high:.3g})"


def cell(value: float) -> Cell:
    """A figure in a table; one that is not there is a dash."""
    return value if math.isfinite(value) else NOTHING if math.isnan(value) else "infinite"


def ratios_figure(outcome: IdentifyOutcome) -> Figure:
    """RMSE over that of the better tuned rival, a panel for each family, the devices sorted by it."""
    with new_figure(7.0, 3.0) as figure:
        panels = figure.subplots(1, len(FAMILIES), sharey=True)
        subjects = (("linearised", MODEL, "default MPC"), ("sampling", MEASURED, "sampling MPC"))
        for axes, family in zip(panels, FAMILIES, strict=True):
            results = sorted((r for r in outcome.done if r.facts["family"] == family), key=over_best)
            best = np.array([min(rmse(r, name) for name in TUNED) for r in results])
            x = np.arange(len(results))
            for (name, colour, label), mark in zip(
                (*subjects, ("exact", PALETTE[5], "device known")), _MARKS, strict=False
            ):
                y = np.array([rmse(r, name) for r in results]) / best
                axes.plot(x, y, mark, color=colour, markersize=3.5, label=label, linestyle="none")
            axes.axhline(1.0, color=REFERENCE, linewidth=0.8)
            axes.axhline(0.5, color=REFERENCE, linewidth=0.6, linestyle="--")
            axes.set(title=family, xticks=[], yscale="log")
        panels[0].set_ylabel("RMSE over the best tuned PID's")
        figure.supxlabel("devices, sorted", fontsize=9.0)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def identify_report(outcome: IdentifyOutcome) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    judged, families, devices = bars_table(bars(outcome)), families_table(outcome), devices_table(outcome)
    caption = "Simulated: RMSE over that of the better of PID and inverse with PID; dashed: one half."
    page = Report(
        "Identified and controlled",
        (
            *_set_up(outcome),
            Heading("Bars"),
            judged.piece,
            Heading("Errors"),
            *([Plot(ratios_figure(outcome), caption)] if outcome.done else []),
            families.piece,
            Heading("Devices"),
            devices.piece,
        ),
        "simulated devices drawn at random, identified from logs, controlled as identified",
    )
    return page, [judged, families, devices, runs_table(outcome)]


def _set_up(outcome: IdentifyOutcome) -> Iterator[Piece]:
    settings = outcome.settings
    yield Heading("Set-up")
    yield Paragraph(_ABOUT)
    yield KeyValues(
        {
            "devices": f"{len(outcome.done)} done, {len(outcome.failed)} failed",
            "model": settings.kind if settings.drive is None else f"{settings.kind} behind a drive ({settings.drive})",
            "evaluations of each search": settings.evaluations,
            "seed": settings.seed,
            "processor time of all devices": f"{sum(r.seconds for r in outcome.results) / 60:.1f} min",
            "hystmpc": outcome.meta.get("versions", {}).get("hystmpc"),
            "started": outcome.meta.get("start"),
        }
    )
    if settings.quick:
        yield Paragraph("QUICK: the numbers below show that everything runs, and say nothing about the controllers.")
    for result in outcome.failed:
        yield Paragraph(f"FAILED: {result.job.key}: {result.message}")

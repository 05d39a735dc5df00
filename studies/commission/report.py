"""The report of the commissioning study: bars, tables, figure, page."""

from __future__ import annotations

import math
from collections.abc import Iterator

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

from ..identify.device import FAMILIES
from ..identify.report import bars_table, cell
from ..identify.scores import rmse_of
from ..tables import Cell, StudyTable
from .bars import RIVALS, CommissionOutcome, bars, over_rival

_ABOUT = """Simulated devices drawn at random: a core (rod, capstan, Dahl, muscle) behind a drive with delay, lag or
servo, and creep, with a noisy sensor. Each is commissioned as `hystmpc commission` does it, on a simulated clock. The
controller that it writes then follows three fresh motions. Each begins behind two flexures that it takes up, as a run
at a bench does. The gains of its rivals, PID and inverse with PID, are searched on the very device and motions under
another realisation of the noise. Every RMSE is of the true angle without the approaches. The same motions are followed
with the model of another device, on a device that has changed, and with other sensors."""
_SHOWN = (
    "commissioned",
    "learning_off",
    *RIVALS,
    "sibling",
    "sibling_off",
    "stranger",
    "stranger_off",
    "wrong_lag",
    "friction",
    "friction_off",
    "stiffness",
    "stiffness_off",
    "none",
    "imaging",
    "imaging_pid",
)
_MARKS = "os^"


def devices_table(outcome: CommissionOutcome) -> StudyTable:
    """A row for each device: the errors of all controllers."""
    rows: list[list[Cell]] = []
    for name, figures in outcome.figures.items():
        errors: list[Cell] = [cell(rmse_of(figures, controller)) for controller in _SHOWN]
        more = (
            figures.get("none.within_band", math.nan),
            figures.get("device_s", math.nan),
            over_rival("commissioned")(figures),
        )
        rows.append([name, *errors, *map(cell, more)])
    columns = ("device", *(f"{name} [deg]" for name in _SHOWN), "within band", "device time [s]", "over best rival")
    return StudyTable("devices", columns, rows, "Simulated: every device; errors are RMSE of the true angle.")


def figures_table(outcome: CommissionOutcome) -> StudyTable:
    """Every figure of every device; CSV only."""
    rows: list[list[Cell]] = [
        [name, figure, cell(value)] for name, figures in outcome.figures.items() for figure, value in figures.items()
    ]
    return StudyTable("figures", ("device", "figure", "value"), rows, "", shown=False)


def ratios_figure(outcome: CommissionOutcome) -> Figure:
    """RMSE over that of the better tuned rival, a panel for each family, the devices sorted by it."""
    subjects = (
        ("commissioned", MODEL, "commissioned"),
        ("sibling", MEASURED, "model of another device"),
        ("stranger", PALETTE[5], "model of another family"),
    )
    with new_figure(7.0, 3.0) as figure:
        panels = figure.subplots(1, len(FAMILIES), sharey=True)
        for axes, family in zip(panels, FAMILIES, strict=True):
            own = [f for name, f in outcome.figures.items() if outcome.families[name] == family]
            own.sort(key=over_rival("commissioned"))
            for (name, colour, label), mark in zip(subjects, _MARKS, strict=True):
                y = np.array([over_rival(name)(f) for f in own])
                axes.plot(np.arange(len(own)), y, mark, color=colour, markersize=3.5, label=label, linestyle="none")
            axes.axhline(1.0, color=REFERENCE, linewidth=0.8)
            axes.axhline(0.5, color=REFERENCE, linewidth=0.6, linestyle="--")
            axes.set(title=family, xticks=[], yscale="log")
        panels[0].set_ylabel("RMSE over the best tuned PID's")
        figure.supxlabel("devices, sorted", fontsize=9.0)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def commission_report(outcome: CommissionOutcome) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    judged, devices = bars_table(bars(outcome)), devices_table(outcome)
    caption = "Simulated: RMSE over that of the better of PID and inverse with PID; dashed: one half."
    page = Report(
        "Commissioned and controlled",
        (
            *_set_up(outcome),
            Heading("Bars"),
            judged.piece,
            Plot(ratios_figure(outcome), caption),
            Heading("Devices"),
            devices.piece,
        ),
        "simulated devices drawn at random, commissioned, and controlled where something has changed",
    )
    return page, [judged, devices, figures_table(outcome)]


def _set_up(outcome: CommissionOutcome) -> Iterator[Piece]:
    settings = outcome.settings
    yield Heading("Set-up")
    yield Paragraph(_ABOUT)
    yield KeyValues(
        {
            "devices": len(outcome.figures),
            "jobs": f"{len(outcome.results) - len(outcome.failed)} done, {len(outcome.failed)} failed",
            "diagnosis in the commissioning": "yes" if settings.diagnose else "no",
            "evaluations of each search": settings.evaluations,
            "seed": settings.seed,
            "processor time of all jobs": f"{sum(r.seconds for r in outcome.results) / 60:.1f} min",
            "hystmpc": outcome.meta.get("versions", {}).get("hystmpc"),
            "started": outcome.meta.get("start"),
        }
    )
    if settings.quick:
        yield Paragraph("QUICK: the numbers below show that everything runs, and say nothing about the controllers.")
    for result in outcome.failed:
        yield Paragraph(f"FAILED: {result.job.key}: {result.message}")

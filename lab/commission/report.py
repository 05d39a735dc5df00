"""The report of the commissioning study: bars, tables, figure, page."""

from __future__ import annotations

import math
from collections.abc import Iterator

from matplotlib.figure import Figure

from hystmpc.trials.report import (
    MEASURED,
    MODEL,
    PALETTE,
    Heading,
    Piece,
    Plot,
    Report,
)

from ..identify.device import FAMILIES
from ..identify.scores import rmse_of
from ..page import bars_table, cell, ratios_figure, set_up
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


def _ratios(outcome: CommissionOutcome) -> Figure:
    """RMSE over that of the better tuned rival."""
    named = ("commissioned", "sibling", "stranger")
    subjects = (("commissioned", MODEL), ("model of another device", MEASURED), ("model of another family", PALETTE[5]))
    rows: dict[str, list[list[float]]] = {family: [] for family in FAMILIES}
    for device, figures in outcome.figures.items():
        rows[outcome.families[device]].append([over_rival(name)(figures) for name in named])
    return ratios_figure(rows, subjects)


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
            Plot(_ratios(outcome), caption),
            Heading("Devices"),
            devices.piece,
        ),
        "simulated devices drawn at random, commissioned, and controlled where something has changed",
    )
    return page, [judged, devices, figures_table(outcome)]


def _set_up(outcome: CommissionOutcome) -> Iterator[Piece]:
    settings = outcome.settings
    facts = {
        "devices": len(outcome.figures),
        "diagnosis in the commissioning": "yes" if settings.diagnose else "no",
        "evaluations of each search": settings.evaluations,
    }
    return set_up(_ABOUT, facts, outcome)

"""The report of the identification study: tables, figure, page."""

from __future__ import annotations

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

from ..page import bars_table, cell, ratios_figure, set_up
from ..tables import NOTHING, Cell, StudyTable
from .bars import CONTROLLERS, PARTS, TUNED, IdentifyOutcome, at_rest, bars, over, over_best, rmse, summary
from .device import FAMILIES
from .job import IdentifyResult

_ABOUT = """Simulated devices drawn at random: a core (rod, capstan, Dahl, muscle) behind a drive with delay, lag or
servo, and creep, with a noisy sensor. A model is identified from three minutes of logs. The predictive controllers have
default settings. The gains of PID and of inverse with PID are searched on the very device and motions under another
realisation of the noise: the strongest opponents of their kind, not forecasts. "exact" is the default controller with
the device itself as its model. Every RMSE is of the true angle over three fresh motions without their approaches."""


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


def _ratios(outcome: IdentifyOutcome) -> Figure:
    """RMSE over that of the better tuned rival."""
    named = ("linearised", "sampling", "exact")
    subjects = (("default MPC", MODEL), ("sampling MPC", MEASURED), ("device known", PALETTE[5]))
    rows: dict[str, list[list[float]]] = {family: [] for family in FAMILIES}
    for r in outcome.done:
        best = min(rmse(r, name) for name in TUNED)
        rows[str(r.facts["family"])].append([rmse(r, name) / best for name in named])
    return ratios_figure(rows, subjects)


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
            *([Plot(_ratios(outcome), caption)] if outcome.done else []),
            families.piece,
            Heading("Devices"),
            devices.piece,
        ),
        "simulated devices drawn at random, identified from logs, controlled as identified",
    )
    return page, [judged, families, devices, runs_table(outcome)]


def _set_up(outcome: IdentifyOutcome) -> Iterator[Piece]:
    settings = outcome.settings
    facts = {
        "model": settings.kind if settings.drive is None else f"{settings.kind} behind a drive ({settings.drive})",
        "evaluations of each search": settings.evaluations,
    }
    return set_up(_ABOUT, facts, outcome)

"""Study `identify`: random devices identified from logs, and controlled as identified; its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from hystmpc.trials.report import MEASURED, MODEL, PALETTE, Heading, Plot, Report

from ..devices.drawn import DrawnDevice, drawn_devices
from ..page import (
    NOTHING,
    Cell,
    StudyTable,
    bars_table,
    cell,
    figures_table,
    judged_by,
    over,
    ratios_figure,
    rmse_of,
    set_up,
)
from ..study import Study
from .job import run_device
from .settings import (
    CONTROLLERS,
    PARTS,
    TUNED,
    IdentifyJob,
    IdentifyOutcome,
    IdentifyResult,
    IdentifySettings,
    as_identified,
    at_rest,
    bars,
    over_best,
    over_exact,
    summary,
)

_ABOUT = """Simulated devices drawn at random: a core (rod, capstan, Dahl, muscle) behind a drive with delay, lag or
servo, and creep, with a noisy sensor. A model is identified from three minutes of logs. The predictive controllers have
default settings. The gains of PID and of inverse with PID are searched on the very device and motions under another
realisation of the noise: the strongest opponents of their kind, not forecasts. "exact" is the default controller with
the device itself as its model. Every RMSE is of the true angle over three fresh motions without their approaches."""


def families_table(outcome: IdentifyOutcome) -> StudyTable:
    """Table of medians by family."""
    rows: list[list[Cell]] = []
    for family in (*outcome.settings.families, None):
        medians = summary(outcome, family)
        rows.append([family or "all", *(cell(value) for value in medians.values())])
    return StudyTable(
        "families", ("family", *summary(outcome)), rows, "Simulated: medians over the devices of a family."
    )


def devices_table(outcome: IdentifyOutcome) -> StudyTable:
    """Table of true values, identified values, and errors of all controllers, a row for each device."""
    rows: list[list[Cell]] = []
    for r in outcome.done:
        parts: list[Cell] = [cell for part in PARTS for cell in (round(r.truth[part], 4), _interval(r, part))]
        errors: list[Cell] = [cell(rmse_of(r.figures, name)) for name in CONTROLLERS]
        ratios = (over_best(r.figures), over_exact(r.figures), as_identified(r.figures))
        facts: list[Cell] = [round(float(r.facts["noise_deg"]), 3), round(float(r.facts["servo_damping"]), 2)]
        rows.append(
            [r.job.key, *facts, *parts, *errors, *map(cell, ratios), cell(at_rest(r.figures)), round(r.seconds, 1)]
        )
    drawn = [name for part in PARTS for name in (part, f"{part} found")]
    columns = ("device", "noise [deg]", "servo damping", *drawn, *(f"{name} [deg]" for name in CONTROLLERS))
    last = ("over best tuned", "over exact", "as identified", "at rest", "time [s]")
    return StudyTable("devices", (*columns, *last), rows, "Simulated: every device; errors are RMSE of the true angle.")


def _interval(result: IdentifyResult, part: str) -> str:
    if part not in result.found:
        return NOTHING
    value, low, high = result.found[part]
    return f"{value:.3g} ({low:.3g} to {high:.3g})"


def _ratios(outcome: IdentifyOutcome) -> Figure:
    """RMSE divided by that of the better tuned rival."""
    named = ("linearised", "sampling", "exact")
    subjects = (("default MPC", MODEL), ("sampling MPC", MEASURED), ("device known", PALETTE[5]))
    rows: dict[str, list[list[float]]] = {family: [] for family in outcome.settings.families}
    for r in outcome.done:
        rows[str(r.facts["family"])].append([over(name, *TUNED)(r.figures) for name in named])
    return ratios_figure(rows, subjects)


def identify_report(outcome: IdentifyOutcome) -> tuple[Report, list[StudyTable]]:
    """Page of the study, and all tables that are written as CSV."""
    judged, families, devices = bars_table(bars(outcome)), families_table(outcome), devices_table(outcome)
    settings = outcome.settings
    facts = {
        "model": settings.kind if settings.drive is None else f"{settings.kind} behind a drive ({settings.drive})",
        "evaluations of each search": settings.evaluations,
    }
    caption = "Simulated: RMSE over that of the better of PID and inverse with PID; dashed: one half."
    page = Report(
        "Identified and controlled",
        (
            *set_up(_ABOUT, facts, outcome),
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
    return page, [judged, families, devices, figures_table({r.job.key: r.figures for r in outcome.done})]


# Processor seconds of a device on one core of a two-core x86-64 machine, from runs of the study itself.
_DEVICE_S = {25.0: 30.0, 50.0: 45.0, 250.0: 140.0}
_ROD = 3.0
_QUICK_S = 5.0


def identify_jobs(settings: IdentifySettings, drawn: Sequence[DrawnDevice]) -> tuple[IdentifyJob, ...]:
    """Jobs of the study, one for each device."""
    return tuple(IdentifyJob(d.number, d.key) for d in settings.chosen(drawn))


def _inputs(job: IdentifyJob, settings: IdentifySettings, folder: Path) -> dict[str, Any]:
    del folder
    return {"device": repr(drawn_devices(settings)[job.number]), "settings": settings.model_dump(mode="json")}


def _facts(job: IdentifyJob, settings: IdentifySettings) -> dict[str, Any]:
    device = drawn_devices(settings)[job.number]
    facts: dict[str, str | float] = {
        "family": device.family,
        "rate_hz": device.rate_hz,
        "noise_deg": device.noise_deg,
        "servo_damping": device.damping,
        "creep_s": device.creep_s,
        "rate_per_s": device.rate_per_s,
    }
    return {"truth": device.truth, "facts": facts}


def _costs(jobs: Sequence[IdentifyJob], settings: IdentifySettings) -> Mapping[str, float]:
    if settings.quick:
        return {job.key: _QUICK_S for job in jobs}
    rates = {job.key: float(job.key.rsplit("-", 1)[1].removesuffix("hz")) for job in jobs}
    return {key: _DEVICE_S[rate] * (_ROD if "-rod-" in key else 1.0) for key, rate in rates.items()}


STUDY = Study(
    name="identify",
    form="hystmpc-identify-job/1",
    settings=IdentifySettings.of,
    result=IdentifyResult,
    draw=drawn_devices,
    jobs=identify_jobs,
    run=run_device,
    inputs=_inputs,
    costs=_costs,
    facts=_facts,
    page=identify_report,
    **judged_by(bars, "devices"),
)

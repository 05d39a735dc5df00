"""Study `commission`: random devices are commissioned, then compared with other models, devices or sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from hystmpc.trials.report import MEASURED, MODEL, PALETTE, Heading, Plot, Report

from ..devices.drawn import DrawnDevice, drawn_devices
from ..page import Cell, StudyTable, bars_table, cell, figures_table, judged_by, ratios_figure, rmse_of, set_up
from ..study import Study
from .job import run_stage
from .settings import (
    RIVALS,
    STAGES,
    CommissionJob,
    CommissionOutcome,
    CommissionResult,
    CommissionStudySettings,
    bars,
    over_rival,
)

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
    """Table of the errors of all controllers, a row for each device."""
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


def _ratios(outcome: CommissionOutcome) -> Figure:
    """RMSE divided by that of the better tuned rival."""
    named = ("commissioned", "sibling", "stranger")
    subjects = (("commissioned", MODEL), ("model of another device", MEASURED), ("model of another family", PALETTE[5]))
    rows: dict[str, list[list[float]]] = {family: [] for family in outcome.settings.families}
    for device, figures in outcome.figures.items():
        rows[outcome.families[device]].append([over_rival(name)(figures) for name in named])
    return ratios_figure(rows, subjects)


def commission_report(outcome: CommissionOutcome) -> tuple[Report, list[StudyTable]]:
    """Page of the study, and all tables that are written as CSV."""
    judged, devices = bars_table(bars(outcome)), devices_table(outcome)
    settings = outcome.settings
    facts = {
        "devices": len(outcome.figures),
        "diagnosis in the commissioning": "yes" if settings.diagnose else "no",
        "evaluations of each search": settings.evaluations,
    }
    caption = "Simulated: RMSE over that of the better of PID and inverse with PID; dashed: one half."
    page = Report(
        "Commissioned and controlled",
        (
            *set_up(_ABOUT, facts, outcome),
            Heading("Bars"),
            judged.piece,
            Plot(_ratios(outcome), caption),
            Heading("Devices"),
            devices.piece,
        ),
        "simulated devices drawn at random, commissioned, and controlled where something has changed",
    )
    return page, [judged, devices, figures_table(outcome.figures)]


# Processor seconds of a job on one core of a two-core x86-64 machine, from runs of the study itself.
_COMMISSION_S = {25.0: 45.0, 50.0: 80.0, 250.0: 400.0}
_COMPARE_S = {25.0: 60.0, 50.0: 100.0, 250.0: 500.0}
_DIAGNOSE, _GAP = 3.0, 0.5  # times a commissioning without
_QUICK_S = 30.0


def commission_jobs(settings: CommissionStudySettings, drawn: Sequence[DrawnDevice]) -> tuple[CommissionJob, ...]:
    """Jobs of each device: commissioning, comparison, and gap; a quick run diagnoses nothing."""
    devices = settings.chosen(drawn)
    stages = STAGES[:2] if settings.quick and not settings.diagnose else STAGES
    return tuple(CommissionJob(d.number, stage, f"{d.key}-{stage}") for stage in stages for d in devices)


def _inputs(job: CommissionJob, settings: CommissionStudySettings, folder: Path) -> dict[str, Any]:
    del folder
    device = drawn_devices(settings)[job.number]
    return {"device": repr(device), "stage": job.stage, "settings": settings.model_dump()}


def _facts(job: CommissionJob, settings: CommissionStudySettings) -> dict[str, Any]:
    device = drawn_devices(settings)[job.number]
    facts = {"family": device.family, "rate_hz": device.rate_hz, "noise_deg": device.noise_deg, **device.truth}
    return {"facts": facts}


def _costs(jobs: Sequence[CommissionJob], settings: CommissionStudySettings) -> Mapping[str, float]:
    return {job.key: _cost_s(job, settings) for job in jobs}


def _cost_s(job: CommissionJob, settings: CommissionStudySettings) -> float:
    if settings.quick:
        return _QUICK_S
    rate = float(job.key.split("-")[2].removesuffix("hz"))
    if job.stage == "gap":
        return _GAP * _COMMISSION_S[rate]
    if job.stage == "compare":
        return _COMPARE_S[rate]
    return _COMMISSION_S[rate] * (_DIAGNOSE if settings.diagnose else 1.0)


STUDY = Study(
    name="commission",
    form="hystmpc-commission-job/1",
    settings=CommissionStudySettings.of,
    result=CommissionResult,
    draw=drawn_devices,
    jobs=commission_jobs,
    run=run_stage,
    inputs=_inputs,
    costs=_costs,
    facts=_facts,
    page=commission_report,
    **judged_by(bars, "jobs"),
    stages=STAGES,
    outcome=CommissionOutcome,
)

"""The study `commission`: drawn devices commissioned, then compared where model, device or sensor are others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..devices.drawn import DrawnDevice
from ..study import Study, StudyTable, bars_summary, plain_result
from .bars import CommissionOutcome, bars
from .job import drawn_devices, run_stage
from .report import commission_report
from .settings import STAGES, CommissionJob, CommissionResult, CommissionStudySettings

# Processor seconds of a job on one core of a two-core x86-64 machine, from runs of the study itself.
_COMMISSION_S = {25.0: 45.0, 50.0: 80.0, 250.0: 400.0}
_COMPARE_S = {25.0: 60.0, 50.0: 100.0, 250.0: 500.0}
_DIAGNOSE, _GAP = 3.0, 0.5  # times a commissioning without
_QUICK_S = 30.0


def commission_jobs(settings: CommissionStudySettings, drawn: Sequence[DrawnDevice]) -> tuple[CommissionJob, ...]:
    """For each device a job to commission it, one to compare and one for the gap; a quick run diagnoses nothing."""
    devices = [d for d in drawn if not settings.rates_hz or d.rate_hz in settings.rates_hz]
    stages = STAGES[:2] if settings.quick and not settings.diagnose else STAGES
    return tuple(CommissionJob(d.number, stage, f"{d.key}-{stage}") for stage in stages for d in devices)


def _inputs(job: CommissionJob, settings: CommissionStudySettings, folder: Path) -> dict[str, Any]:
    """The device's numbers, the stage and the settings."""
    del folder
    device = drawn_devices(settings)[job.number]
    return {"device": repr(device), "stage": job.stage, "settings": settings.model_dump()}


def _facts(job: CommissionJob, settings: CommissionStudySettings) -> dict[str, Any]:
    """What the device is."""
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


def _data(outcome: CommissionOutcome) -> dict[str, Any]:
    return {"bars": [bar.plain for bar in bars(outcome)], "jobs": [plain_result(r) for r in outcome.results]}


def _summary(outcome: CommissionOutcome) -> StudyTable:
    return bars_summary(bars(outcome))


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
    data=_data,
    summary=_summary,
    stages=STAGES,
    outcome=CommissionOutcome,
)

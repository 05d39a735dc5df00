"""The study `identify`: drawn devices identified from logs, and controlled as identified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..devices.drawn import DrawnDevice
from ..study import Study, StudyTable, bars_summary, plain_result
from .bars import IdentifyOutcome, bars
from .job import drawn_devices, run_device
from .report import identify_report
from .settings import IdentifyJob, IdentifyResult, IdentifySettings

# Processor seconds of a device on one core of a two-core x86-64 machine, from runs of the study itself.
_DEVICE_S = {25.0: 30.0, 50.0: 45.0, 250.0: 140.0}
_ROD = 3.0
_QUICK_S = 5.0


def identify_jobs(settings: IdentifySettings, drawn: Sequence[DrawnDevice]) -> tuple[IdentifyJob, ...]:
    """A job for each device."""
    rates = settings.rates_hz
    return tuple(IdentifyJob(d.number, d.key) for d in drawn if not rates or d.rate_hz in rates)


def _inputs(job: IdentifyJob, settings: IdentifySettings, folder: Path) -> dict[str, Any]:
    """The device's numbers and the settings."""
    del folder
    return {"device": repr(drawn_devices(settings)[job.number]), "settings": settings.model_dump(mode="json")}


def _facts(job: IdentifyJob, settings: IdentifySettings) -> dict[str, Any]:
    """What the device is."""
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


def _data(outcome: IdentifyOutcome) -> dict[str, Any]:
    return {"bars": [bar.plain for bar in bars(outcome)], "devices": [plain_result(r) for r in outcome.results]}


def _summary(outcome: IdentifyOutcome) -> StudyTable:
    return bars_summary(bars(outcome))


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
    data=_data,
    summary=_summary,
)

"""The whole study: every device commissioned, then compared; in a run folder that the same command goes on from."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from hystmpc.sim.jobs.runner import attempt
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Progress

from ..ready import ReadyStudy, ready_study
from .bars import CommissionOutcome, bars
from .job import (
    STAGES,
    CommissionJob,
    CommissionResult,
    as_result,
    commission_jobs,
    do_stage,
    fingerprint,
    plain,
    result_files,
)
from .report import commission_report
from .settings import CommissionStudySettings

# Processor seconds of a job on one core of a two-core x86-64 machine, from runs of the study itself.
_COMMISSION_S = {25.0: 45.0, 50.0: 80.0, 250.0: 400.0}
_COMPARE_S = {25.0: 60.0, 50.0: 100.0, 250.0: 500.0}
_DIAGNOSE, _GAP = 3.0, 0.5  # times a commissioning without
_QUICK_S = 30.0

ReadyCommission = ReadyStudy[CommissionStudySettings, CommissionJob, CommissionResult]


def prepare_commission(settings: CommissionStudySettings, out: Path | str) -> ReadyCommission:
    """Draw the devices and open the folder; see `ready_study`."""
    return ready_study(
        settings,
        settings.study,
        commission_jobs(settings),
        out,
        result_files,
        lambda job, folder: fingerprint(job, settings),
        lambda jobs: {job.key: _cost_s(job, settings) for job in jobs},
    )


def run_commission(study: ReadyCommission, workers: int = 1, progress: Progress | None = None) -> CommissionOutcome:
    """Do the open jobs and write report, tables and results; see `ReadyStudy.complete` for arguments and errors."""
    folder = study.folder.path
    do = partial(do_job, settings=study.settings, folder=folder)
    stages = [[job for job in study.jobs if job.stage == stage] for stage in STAGES]
    results = study.complete(stages, do, workers, progress)
    outcome = CommissionOutcome(study.settings, results, folder, study.folder.meta)
    page, tables = commission_report(outcome)
    for table in tables:
        table.save(folder)
    judged = [
        asdict(bar) | {"state": bar.state, "value": bar.value if bar.value < 1e300 else None} for bar in bars(outcome)
    ]
    data = {"bars": judged, "jobs": [plain(result) for result in results]}
    write_atomically(folder / "tables" / "commission.json", json.dumps(data, indent=1) + "\n")
    study.folder.write_report(page.html())
    return outcome


def do_job(job: CommissionJob, settings: CommissionStudySettings, folder: Path) -> CommissionResult:
    """Do one job and write its result; an error is a result too.

    Raises:
        KeyboardInterrupt: if the user ended it; nothing is written then.
    """
    made = attempt(lambda: do_stage(job, settings, folder))
    result = replace(as_result(job, settings), message=made.error, seconds=made.seconds)
    if made.value is not None:
        message, figures = made.value
        result = replace(result, status="done", message=message, figures=figures)
    result_files(folder).save(result)
    return result


def _cost_s(job: CommissionJob, settings: CommissionStudySettings) -> float:
    if settings.quick:
        return _QUICK_S
    rate = float(job.key.split("-")[2].removesuffix("hz"))
    if job.stage == "gap":
        return _GAP * _COMMISSION_S[rate]
    if job.stage == "compare":
        return _COMPARE_S[rate]
    return _COMMISSION_S[rate] * (_DIAGNOSE if settings.diagnose else 1.0)

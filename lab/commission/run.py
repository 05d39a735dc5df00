"""The whole study: every device commissioned, then compared; in a run folder that the same command goes on from."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from hystmpc.trials.types import Progress

from ..ready import ReadyStudy, do_kept, ready_study
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
    study.leave(page, tables, {"bars": [b.plain for b in bars(outcome)], "jobs": [plain(r) for r in results]})
    return outcome


def do_job(job: CommissionJob, settings: CommissionStudySettings, folder: Path) -> CommissionResult:
    """Do one job and write its result; see `do_kept`."""
    fields = ("message", "figures")
    return do_kept(as_result(job, settings), fields, lambda: do_stage(job, settings, folder), result_files(folder))


def _cost_s(job: CommissionJob, settings: CommissionStudySettings) -> float:
    if settings.quick:
        return _QUICK_S
    rate = float(job.key.split("-")[2].removesuffix("hz"))
    if job.stage == "gap":
        return _GAP * _COMMISSION_S[rate]
    if job.stage == "compare":
        return _COMPARE_S[rate]
    return _COMMISSION_S[rate] * (_DIAGNOSE if settings.diagnose else 1.0)

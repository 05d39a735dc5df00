"""The whole study: a job for each device, bars, report; in a run folder that the same command goes on from."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from hystmpc.trials.types import Progress

from ..ready import ReadyStudy, do_kept, ready_study
from .bars import IdentifyOutcome, bars
from .job import IdentifyJob, IdentifyResult, as_result, fingerprint, identify_jobs, plain, result_files, study_device
from .report import identify_report
from .settings import IdentifySettings

# Processor seconds of a device on one core of a two-core x86-64 machine, from runs of the study itself.
_DEVICE_S = {25.0: 30.0, 50.0: 45.0, 250.0: 140.0}
_ROD = 3.0
_QUICK_S = 5.0


def prepare_identify(
    settings: IdentifySettings, out: Path | str
) -> ReadyStudy[IdentifySettings, IdentifyJob, IdentifyResult]:
    """Draw the devices and open the folder; see `ready_study`."""
    return ready_study(
        settings,
        settings.study,
        identify_jobs(settings),
        out,
        result_files,
        lambda job, folder: fingerprint(job, settings),
        lambda jobs: {job.key: _cost_s(job, settings) for job in jobs},
    )


def run_identify(
    study: ReadyStudy[IdentifySettings, IdentifyJob, IdentifyResult], workers: int = 1, progress: Progress | None = None
) -> IdentifyOutcome:
    """Do the open jobs and write report, tables and results; see `ReadyStudy.complete` for arguments and errors."""
    folder = study.folder.path
    do = partial(do_job, settings=study.settings, folder=folder)
    results = study.complete([study.jobs], do, workers, progress)
    outcome = IdentifyOutcome(study.settings, results, folder, study.folder.meta)
    page, tables = identify_report(outcome)
    study.leave(page, tables, {"bars": [b.plain for b in bars(outcome)], "devices": [plain(r) for r in results]})
    return outcome


def do_job(job: IdentifyJob, settings: IdentifySettings, folder: Path) -> IdentifyResult:
    """Do one job and write its result; see `do_kept`."""
    fields = ("message", "found", "figures")
    return do_kept(as_result(job, settings), fields, lambda: study_device(job, settings, folder), result_files(folder))


def _cost_s(job: IdentifyJob, settings: IdentifySettings) -> float:
    if settings.quick:
        return _QUICK_S
    rate = float(job.key.rsplit("-", 1)[1].removesuffix("hz"))
    return _DEVICE_S[rate] * (_ROD if "-rod-" in job.key else 1.0)

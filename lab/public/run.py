"""The whole study of a public data set: a job for each case and kind, then the page; the same command goes on."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from hystmpc.trials.types import Progress

from ..ready import ReadyStudy, do_kept, ready_study
from .catalogue import data_set
from .job import PublicJob, PublicResult, fingerprint, public_jobs, result_files, study_kind
from .report import PublicOutcome, public_report
from .settings import PublicSettings

# Processor seconds of a fit on one core of a two-core x86-64 machine, from runs of the study itself.
_FIT_S = {"oscillator": 15.0, "state_network": 200.0, "auto": 20.0, "maxwell_slip_rate": 15.0}
_OTHER_S, _QUICK_S = 10.0, 30.0

ReadyPublic = ReadyStudy[PublicSettings, PublicJob, PublicResult]


def prepare_public(settings: PublicSettings, out: Path | str) -> ReadyPublic:
    """Read the records and open the folder; see `ready_study`.

    Raises:
        LogError: if a record cannot be used.
    """
    cases = data_set(settings).cases(settings)
    return ready_study(
        settings,
        settings.study,
        public_jobs(settings, cases),
        out,
        result_files,
        lambda job, folder: fingerprint(job, settings),
        lambda jobs: {job.key: _QUICK_S if settings.quick else _FIT_S.get(job.kind, _OTHER_S) for job in jobs},
    )


def run_public(study: ReadyPublic, workers: int = 1, progress: Progress | None = None) -> PublicOutcome:
    """Do the open jobs and write report, tables and results; see `ReadyStudy.complete` for arguments and errors."""
    folder = study.folder.path
    do = partial(do_job, settings=study.settings, folder=folder)
    results = study.complete([study.jobs], do, workers, progress)
    outcome = PublicOutcome(
        study.settings, data_set(study.settings).cases(study.settings), results, folder, study.folder.meta
    )
    page, tables = public_report(outcome)
    study.leave(page, tables)
    return outcome


def do_job(job: PublicJob, settings: PublicSettings, folder: Path) -> PublicResult:
    """Do one job and write its result; see `do_kept`."""
    blank = PublicResult(job, fingerprint(job, settings), "failed", "", 0.0)
    fields = ("message", "fit_s", "parameters", "scores")
    return do_kept(blank, fields, lambda: study_kind(job, settings, folder), result_files(folder))

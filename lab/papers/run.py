"""A whole study: trials, jobs, report; in a run folder that the same command goes on from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hystmpc.trials.report import Report
from hystmpc.trials.types import Progress

from ..ready import ReadyStudy, ready_study
from ..tables import StudyTable
from .job import Splits, TrainingTask, study_splits
from .real import real_report, real_tasks
from .result import JobResult, StudyOutcome, result_files
from .s1 import s1_report, s1_tasks
from .s2_plan import s2_tasks
from .s2_report import s2_report
from .settings import StudySettings
from .worker import do_job, estimated_seconds

_PLANS: dict[str, Callable[[StudySettings, Splits], tuple[TrainingTask, ...]]] = {
    "s1": s1_tasks,
    "s2": s2_tasks,
    "real": real_tasks,
}
_REPORTS: dict[str, Callable[[StudyOutcome], tuple[Report, list[StudyTable]]]] = {
    "s1": s1_report,
    "s2": s2_report,
    "real": real_report,
}


@dataclass(frozen=True, eq=False)
class PaperStudy:
    """A study made ready, and its trials."""

    ready: ReadyStudy[StudySettings, TrainingTask, JobResult]
    splits: Splits


def prepare(settings: StudySettings, out: Path | str) -> PaperStudy:
    """Make or read the trials, plan the jobs, open the folder; see `ready_study`.

    Raises:
        ConfigError: if the folder holds something else, another study, or logs are wrong.
        LogError: if a log cannot be read, or a result is damaged.
    """
    splits = study_splits(settings)
    ready = ready_study(
        settings,
        settings.study,
        _PLANS[settings.study](settings, splits),
        out,
        result_files,
        lambda task, folder: task.fingerprint,
        lambda tasks: estimated_seconds(tasks, timed=not settings.quick),
    )
    return PaperStudy(ready, splits)


def run_study(study: PaperStudy, workers: int = 1, progress: Progress | None = None) -> StudyOutcome:
    """Do the open jobs and write report and tables; see `ReadyStudy.complete` for arguments and errors.

    Raises:
        ModelError: if a model's file is gone or damaged.
    """
    ready, folder = study.ready, study.ready.folder.path
    results = ready.complete([ready.jobs], partial(do_job, folder=folder), workers, progress)
    outcome = StudyOutcome(ready.settings, study.splits, results, folder, ready.folder.meta)
    page, tables = _REPORTS[ready.settings.study](outcome)
    ready.leave(page, tables)
    return outcome

"""A whole study: trials, jobs, report; in a run folder that the same command goes on from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hystmpc.sim.jobs.runner import backend_for, resumed_folder, wall_minutes
from hystmpc.trials.report import Report
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import Progress

from ..tables import StudyTable, other_study
from .job import Splits, TrainingTask, study_splits
from .real import real_report, real_tasks
from .result import StudyOutcome, result_files
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
    """A study made ready: its folder is there, nothing is trained yet.

    Attributes:
        costs: expected seconds by key of the jobs that are not done yet.
    """

    settings: StudySettings
    splits: Splits
    tasks: tuple[TrainingTask, ...]
    folder: RunFolder
    costs: Mapping[str, float]

    def minutes(self, workers: int) -> int:
        """Estimated wall time of the jobs that are not done yet [min]."""
        return wall_minutes(self.costs, workers)


def prepare(settings: StudySettings, out: Path | str) -> PaperStudy:
    """Make or read the trials, plan the jobs, open the folder.

    Args:
        out: a new or empty folder, or one in which the same study was begun; its finished jobs are kept.

    Raises:
        ConfigError: if the folder holds something else, another study, or logs are wrong.
        LogError: if a log cannot be read, or a result is damaged.
    """
    splits = study_splits(settings)
    tasks = _PLANS[settings.study](settings, splits)
    folder = resumed_folder(
        Path(out), settings.model_dump(mode="json"), settings.seed, partial(other_study, settings.study)
    )
    kept = result_files(folder.path).kept(tasks, lambda task: task.fingerprint)
    costs = estimated_seconds([task for task in tasks if task.key not in kept], timed=not settings.quick)
    return PaperStudy(settings, splits, tasks, folder, costs)


def run_study(study: PaperStudy, workers: int = 1, progress: Progress | None = None) -> StudyOutcome:
    """Do the open jobs and write report and tables.

    Args:
        study: made by `prepare`.
        workers: processes, each on one thread; with 1 the jobs run in this process.
        progress: see `ResultFiles.complete`.

    Raises:
        ConfigError: if worker processes died again and again.
        LogError: if a result's file is damaged.
        ModelError: if a model's file is gone or damaged.
        KeyboardInterrupt: if the user ended it; finished jobs are kept, the report is not written.
    """
    folder = study.folder.path
    results = result_files(folder).complete(
        [study.tasks],
        partial(do_job, folder=folder),
        lambda task: task.fingerprint,
        backend_for(workers, where=str(folder)),
        study.costs,
        progress,
    )
    outcome = StudyOutcome(study.settings, study.splits, results, folder, study.folder.meta)
    page, tables = _REPORTS[study.settings.study](outcome)
    for table in tables:
        table.save(folder)
    study.folder.write_report(page.html())
    return outcome

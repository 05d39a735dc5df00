"""A whole study: trials, jobs, report; in a run folder that it goes on from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.report import Report
from hystmpc.trials.run_folder import RunFolder

from .control_settings import ControlSettings
from .datasets import study_splits
from .estimate import estimated_seconds, wall_minutes
from .job import Splits, Task
from .outcome import Outcome
from .pool import kept_results, run_jobs
from .real_plan import real_tasks
from .real_report import real_report
from .s1_plan import s1_tasks
from .s1_report import s1_report
from .s2_plan import s2_tasks
from .s2_report import s2_report
from .settings import StudySettings
from .tables import StudyTable
from .tally import Progress

_PLANS: dict[str, Callable[[StudySettings, Splits], tuple[Task, ...]]] = {
    "s1": s1_tasks,
    "s2": s2_tasks,
    "real": real_tasks,
}
_REPORTS: dict[str, Callable[[Outcome], tuple[Report, list[StudyTable]]]] = {
    "s1": s1_report,
    "s2": s2_report,
    "real": real_report,
}


@dataclass(frozen=True, eq=False)
class Study:
    """A study made ready: its folder is there, nothing is trained yet.

    Attributes:
        settings: of the study.
        splits: its trials.
        tasks: its jobs.
        folder: run folder.
        costs: expected seconds by key of the jobs that are not done yet.
    """

    settings: StudySettings
    splits: Splits
    tasks: tuple[Task, ...]
    folder: RunFolder
    costs: Mapping[str, float]

    def minutes(self, workers: int) -> int:
        """Estimated wall time of the jobs that are not done yet [min]."""
        return wall_minutes(self.costs, workers)


def prepare(settings: StudySettings, out: Path | str) -> Study:
    """Make or read the trials, plan the jobs, open the folder.

    Args:
        settings: of the study.
        out: a new or empty folder, or one in which the same study was begun; its finished jobs are kept.

    Raises:
        ConfigError: if the folder holds something else, another study, or logs are wrong.
        LogError: if a log cannot be read, or a result is damaged.
    """
    splits = study_splits(settings)
    tasks = _PLANS[settings.study](settings, splits)
    folder = study_folder(Path(out), settings)
    kept = kept_results(tasks, folder.path)
    costs = estimated_seconds([task for task in tasks if task.job.key not in kept], timed=not settings.quick)
    return Study(settings, splits, tasks, folder, costs)


def run_study(study: Study, workers: int = 1, progress: Progress | None = None) -> Outcome:
    """Do the open jobs and write report and tables.

    Args:
        study: made by `prepare`.
        workers: processes.
        progress: see `run_jobs`.

    Raises:
        ConfigError: if a worker process died.
        LogError: if a result's file is damaged.
        ModelError: if a model's file is gone or damaged.
        KeyboardInterrupt: if the user ended it; finished jobs are kept, the report is not written.
    """
    results = run_jobs(study.tasks, study.folder.path, workers, study.costs, progress)
    outcome = Outcome(study.settings, study.splits, results, study.folder.path, study.folder.meta)
    page, tables = _REPORTS[study.settings.study](outcome)
    for table in tables:
        table.save(study.folder.path)
    study.folder.write_report(page.html())
    return outcome


def study_folder(path: Path, settings: StudySettings | ControlSettings) -> RunFolder:
    """A new run folder, or the one that this study left.

    Raises:
        ConfigError: if the folder holds something else.
    """
    plain = settings.model_dump(mode="json")
    if not (path / "meta.json").exists():
        return RunFolder.create(path, plain, seed=settings.seed)
    folder = RunFolder.open(path)
    before = folder.config()
    study = before.get("study") if isinstance(before, dict) else None
    if study != settings.study:
        raise ConfigError(f"{path}: holds a run of {study or 'something else'}, expected one of study {settings.study}")
    write_atomically(path / "config.yaml", dump_yaml(plain))
    return folder

"""A study of many jobs in a run folder: made ready, its jobs done; the same command goes on from it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar, final

from hystmpc.sim.jobs.runner import (
    PlannedJob,
    PlannedResult,
    ResultFiles,
    attempt,
    backend_for,
    resumed_folder,
    wall_minutes,
)
from hystmpc.trials.config import Settings
from hystmpc.trials.files import write_atomically
from hystmpc.trials.report import Report
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import Progress

from .tables import StudyTable, other_study

S = TypeVar("S", bound=Settings)
J = TypeVar("J", bound=PlannedJob)
F = TypeVar("F", bound=PlannedResult)


@final
@dataclass(frozen=True, eq=False)
class ReadyStudy(Generic[S, J, F]):
    """A study made ready: its folder is there, nothing has run yet.

    Attributes:
        study: its name.
        jobs: all of them.
        folder: of the run.
        results: files of their results.
        mark: fingerprint of all that a job depends on.
        costs: expected processor time of the jobs that are not done yet, by key [s].
    """

    study: str
    settings: S
    jobs: tuple[J, ...]
    folder: RunFolder
    results: ResultFiles[F]
    mark: Callable[[J], str]
    costs: Mapping[str, float]

    def minutes(self, workers: int) -> int:
        """Estimated wall time of the jobs that are not done yet [min]."""
        return wall_minutes(self.costs, workers)

    def complete(
        self, stages: Sequence[Sequence[J]], do: Callable[[J], F], workers: int, progress: Progress | None
    ) -> tuple[F, ...]:
        """Results of all jobs; the open ones are done, stage by stage.

        Args:
            do: does one job and saves its result.
            workers: processes, each on one thread; with 1 the jobs run in this process.
            progress: see `ResultFiles.complete`.

        Raises:
            ConfigError: if worker processes died again and again.
            LogError: if a result's file is damaged.
            KeyboardInterrupt: if the user ended it; finished jobs are kept.
        """
        backend = backend_for(workers, where=str(self.folder.path))
        return self.results.complete(stages, do, self.mark, backend, self.costs, progress)

    def leave(self, page: Report, tables: Sequence[StudyTable], data: Mapping[str, Any] | None = None) -> None:
        """Write the page, the tables as CSV, and `tables/STUDY.json` where there is data for it.

        Raises:
            ValueError: if a number in the data is not finite: JSON has no word for it.
        """
        for table in tables:
            table.save(self.folder.path)
        if data is not None:
            text = json.dumps(data, indent=1, allow_nan=False) + "\n"
            write_atomically(self.folder.path / "tables" / f"{self.study}.json", text)
        self.folder.write_report(page)


def do_kept(blank: Any, fields: Sequence[str], do: Callable[[], Sequence[Any]], files: ResultFiles[F]) -> F:
    """Do one job and write its result; an error is a result too.

    Args:
        blank: the result before anything is done, of status `failed`.
        fields: of the result, that `do` returns.

    Raises:
        KeyboardInterrupt: if the user ended it; nothing is written then.
    """
    made = attempt(do)
    result: F = replace(blank, message=made.error, seconds=made.seconds)
    if made.value is not None:
        found: Any = result
        result = replace(found, status="done", **dict(zip(fields, made.value, strict=True)))
    files.save(result)
    return result


def ready_study(
    settings: S,
    study: str,
    jobs: tuple[J, ...],
    out: Path | str,
    results: Callable[[Path], ResultFiles[F]],
    mark: Callable[[J, Path], str],
    costs: Callable[[Sequence[J]], Mapping[str, float]],
) -> ReadyStudy[S, J, F]:
    """Open the folder of a study and see what is done.

    Args:
        study: its name, as in `config.yaml`.
        out: a new or empty folder, or one in which the study was begun; its finished jobs are kept.
        results: files of the results in a folder.
        mark: fingerprint of all that a job depends on, with the folder.
        costs: expected processor time of jobs by key [s].

    Raises:
        ConfigError: if the folder holds something else.
        LogError: if a result is damaged.
    """
    plain = settings.model_dump(mode="json")
    folder = resumed_folder(Path(out), plain, int(plain["seed"]), partial(other_study, study))
    files = results(folder.path)

    def marked(job: J) -> str:
        return mark(job, folder.path)

    kept = files.kept(jobs, marked)
    expected = costs([job for job in jobs if job.key not in kept])
    return ReadyStudy(study, settings, jobs, folder, files, marked, expected)

"""Doing the jobs of a study: what is done already is kept, the rest runs in parallel, longest first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from hystmpc.sim.parallel.backend import backend_for

from .job import Task
from .result import JobResult, load_result, save_result
from .tally import Progress, Tally
from .worker import run_job


def kept_results(tasks: Sequence[Task], folder: Path) -> dict[str, JobResult]:
    """Results by key that need not be computed again: done, from the same settings and trials.

    Raises:
        LogError: if a result's file is damaged.
    """
    found = {task.job.key: load_result(folder, task.job) for task in tasks}
    return {
        task.job.key: result
        for task in tasks
        if (result := found[task.job.key]) and result.status == "done" and result.fingerprint == task.fingerprint
    }


def run_jobs(
    tasks: Sequence[Task], folder: Path, workers: int, costs: Mapping[str, float], progress: Progress | None = None
) -> tuple[JobResult, ...]:
    """Results of all jobs in their order; each is on disk as soon as it is there.

    Args:
        tasks: with different keys.
        folder: of the study; holds `results` and `models`.
        workers: processes, each on one thread; with 1 the jobs run in this process.
        costs: expected seconds by key, of the jobs that are not done yet; see `estimated_seconds`.
        progress: called at the start and after every job.

    Raises:
        ConfigError: if worker processes died again and again.
        LogError: if a result's file is damaged.
        KeyboardInterrupt: if the user ended it; finished jobs are kept.
    """
    for half in (part for name in ("results", "models") for part in (folder / name).glob(".*.part")):
        half.unlink(missing_ok=True)  # left by a process that was killed while it wrote
    results = kept_results(tasks, folder)
    rest = [task for task in tasks if task.job.key not in results]
    rest.sort(key=lambda task: costs.get(task.job.key, 0.0), reverse=True)
    total, seconds = sum(costs.get(task.job.key, 0.0) for task in rest), 0.0
    if progress:
        progress(Tally(len(results), len(tasks), 0.0, total))
    backend = backend_for(workers, where=str(folder))
    for result in backend.results(partial(do_job, folder=folder), rest):
        results[result.job.key] = result
        seconds += costs.get(result.job.key, 0.0)
        if progress:
            note = result.job.key if result.status == "done" else f"{result.job.key} failed"
            progress(Tally(len(results), len(tasks), seconds, total, note))
    return tuple(results[task.job.key] for task in tasks)


def do_job(task: Task, folder: Path) -> JobResult:
    """Do one job and write its result.

    Raises:
        KeyboardInterrupt: if the user ended it.
    """
    result = run_job(task, folder)
    save_result(folder, result)
    return result

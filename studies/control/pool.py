"""Doing the jobs of the benchmark stage by stage: what is done already is kept, the rest runs in parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from hystmpc.sim.parallel.backend import backend_for

from ..papers.tally import Progress, Tally
from .job import STAGES, ControlJob, fingerprint
from .result import ControlResult, load
from .settings import ControlSettings
from .worker import do_control_job


def kept(jobs: Sequence[ControlJob], settings: ControlSettings, folder: Path) -> dict[str, ControlResult]:
    """Results by key that need not be computed again: done, and all that they depend on is the same.

    Raises:
        LogError: if a result's file is damaged.
    """
    found = {job.key: load(folder, job) for job in jobs}
    return {
        job.key: result
        for job in jobs
        if (result := found[job.key])
        and result.status == "done"
        and result.fingerprint == fingerprint(job, settings, folder)
    }


def run_control_jobs(
    jobs: Sequence[ControlJob],
    settings: ControlSettings,
    folder: Path,
    workers: int,
    costs: Mapping[str, float],
    progress: Progress | None = None,
) -> tuple[ControlResult, ...]:
    """Results of all jobs in their order; each is on disk as soon as it is there.

    Args:
        jobs: with different keys, stage by stage.
        settings: of the study.
        folder: of the study.
        workers: processes, each on one thread; with 1 the jobs run in this process.
        costs: expected seconds by key.
        progress: called at the start and after every job.

    Raises:
        ConfigError: if worker processes died again and again.
        LogError: if a result's file is damaged.
        KeyboardInterrupt: if the user ended it; finished jobs are kept.
    """
    for half in (part for name in ("results", "models", "runs") for part in (folder / name).glob(".*.part")):
        half.unlink(missing_ok=True)  # left by a process that was killed while it wrote
    results, backend = kept(jobs, settings, folder), backend_for(workers, where=str(folder))
    seconds, total = 0.0, sum(costs[job.key] for job in jobs if job.key not in results)
    if progress:
        progress(Tally(len(results), len(jobs), 0.0, total))
    for stage in STAGES:
        # Asked again here: a model that has changed makes its runs out of date.
        mine = [job for job in jobs if job.stage == stage]
        fresh = kept(mine, settings, folder)
        rest = sorted((job for job in mine if job.key not in fresh), key=lambda job: -costs[job.key])
        again = [job.key for job in rest if job.key in results]
        results = {key: result for key, result in results.items() if key not in again} | fresh
        total += sum(costs[key] for key in again)
        for result in backend.results(partial(do_control_job, settings=settings, folder=folder), rest):
            results[result.job.key] = result
            seconds += costs[result.job.key]
            if progress:
                note = result.job.key if result.status == "done" else f"{result.job.key} failed"
                progress(Tally(len(results), len(jobs), seconds, total, note))
    return tuple(results[job.key] for job in jobs)

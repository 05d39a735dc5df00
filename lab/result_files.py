"""Results of the jobs of a study: a file each; finished jobs are kept, the same command does the rest."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, Literal, Protocol, TypeVar, final

from pydantic import TypeAdapter

from hystmpc.sim.jobs import Backend, run_jobs
from hystmpc.trials.errors import LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Progress

Status = Literal["done", "failed"]


class PlannedJob(Protocol):
    """A job of a plan."""

    @property
    def key(self) -> str:
        """Name of the job's files, unique in the plan."""
        ...


class PlannedResult(Protocol):
    """Outcome of a job."""

    @property
    def job(self) -> PlannedJob:
        """The job."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash of all that the result depends on."""
        ...

    @property
    def status(self) -> Status:
        """Whether it worked."""
        ...


J = TypeVar("J", bound=PlannedJob)
F = TypeVar("F", bound=PlannedResult)


@final
class ResultFiles(Generic[F]):
    """Results of jobs as one JSON file each, `results/KEY.json`, written whole or not at all."""

    def __init__(self, folder: Path, kind: type[F], form: str, encode: Callable[[Any], dict[str, Any]] = asdict):
        self.folder, self._form, self._encode = folder, form, encode
        self._adapter = TypeAdapter(kind)

    def path(self, job: PlannedJob) -> Path:
        """File of a job's result."""
        return self.folder / "results" / f"{job.key}.json"

    def save(self, result: F) -> Path:
        """Write a result."""
        data = {"format": self._form} | self._encode(result)
        return write_atomically(self.path(result.job), json.dumps(data, indent=1) + "\n")

    def load(self, job: PlannedJob) -> F | None:
        """The result of a job, None where there is none yet.

        Raises:
            LogError: if the file is not a result.
        """
        path = self.path(job)
        if not path.exists():
            return None
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            found = data.pop("format")
            result = self._adapter.validate_python(data)
        except (ValueError, KeyError, TypeError, AttributeError) as error:  # pydantic's errors are ValueErrors
            reason = " ".join(str(error).split())
            raise LogError(
                f"{path}: not a result of a study ({reason}); remove it to have the job done again"
            ) from None
        if found != self._form:
            raise LogError(f"{path}: not of the format {self._form}; remove it to have the job done again")
        return result

    def kept(self, jobs: Iterable[J], fingerprint: Callable[[J], str]) -> dict[str, F]:
        """Results by key that are done and up to date; a failed or outdated job is done again.

        Raises:
            LogError: if a file is damaged.
        """
        found = ((job, self.load(job)) for job in jobs)
        return {
            job.key: result
            for job, result in found
            if result and result.status == "done" and result.fingerprint == fingerprint(job)
        }

    def complete(
        self,
        stages: Sequence[Sequence[J]],
        do: Callable[[J], F],
        fingerprint: Callable[[J], str],
        backend: Backend,
        costs: Mapping[str, float],
        progress: Progress | None = None,
    ) -> tuple[F, ...]:
        """Results of all jobs in their order: kept ones, and the others done stage by stage, the costliest first.

        Args:
            stages: jobs with different keys; each stage may need files that the stages before it leave.
            do: does one job and saves its result.
            fingerprint: hash of all that a job depends on.
            costs: expected processor time by key [s].
            progress: called at the start and after every job, in expected seconds, so that a bar's time left is that
                of the jobs left.

        Raises:
            ConfigError: if worker processes died again and again.
            LogError: if a result's file is damaged.
            KeyboardInterrupt: if the user ended it; finished jobs are kept.
        """
        for half in self.folder.glob("*/.*.part"):
            half.unlink(missing_ok=True)  # left by a process that was killed while it wrote
        jobs = [job for stage in stages for job in stage]
        results = self.kept(jobs, fingerprint)
        spent, total = 0.0, sum(costs.get(job.key, 0.0) for job in jobs if job.key not in results)

        def tell(note: str = "") -> None:
            if progress:
                progress(spent, max(total, 1e-9), f"{len(results)} of {len(jobs)} jobs {note}")

        tell()
        for stage in stages:
            # Asked again after the first stage: an earlier one may have changed what these jobs read.
            fresh = results if stage is stages[0] else self.kept(stage, fingerprint)
            rest = [job for job in stage if job.key not in fresh]
            total += sum(costs.get(job.key, 0.0) for job in rest if results.pop(job.key, None))
            rest.sort(key=lambda job: costs.get(job.key, 0.0), reverse=True)
            for result in run_jobs(do, rest, backend):
                results[result.job.key] = result
                spent += costs.get(result.job.key, 0.0)
                tell(result.job.key if result.status == "done" else f"{result.job.key} failed")
        return tuple(results[job.key] for job in jobs)


def wall_minutes(costs: Mapping[str, float], workers: int) -> int:
    """Wall time of jobs of these costs [s] on so many workers, rounded up; never less than the longest job [min]."""
    longest = max(costs.values(), default=0.0)
    return math.ceil(max(sum(costs.values()) / workers, longest) / 60)

"""Plans of jobs that survive a kill or Ctrl-C: finished jobs are kept, the same command does the rest."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, Literal, Protocol, TypeVar, final

from filelock import FileLock, Timeout
from pydantic import TypeAdapter

from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError, FitInterruptedError, HystmpcError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import Progress

from .backend import Backend, InTurn, Processes, R, T

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


def run_jobs(
    jobs: Iterable[T],
    do: Callable[[T], R],
    backend: Backend,
    *,
    is_done: Callable[[T], bool] = lambda job: False,
    total: int,
    progress: Progress | None = None,
    note: Callable[[R], str] = lambda result: "",
) -> Iterator[R]:
    """Results of the jobs that are not done yet, as they come, in any order.

    Args:
        do: does one job, in another process where the backend has some.
        is_done: whether a job was done by an earlier call.
        total: number of jobs, for `progress`.
        progress: called after every job; jobs done earlier count.
        note: text for `progress`.

    Raises:
        ConfigError: if workers die again and again, or there are none.
    """
    kept = 0

    def open_jobs() -> Iterator[T]:
        nonlocal kept
        for job in jobs:
            if is_done(job):
                kept += 1
            else:
                yield job

    for number, result in enumerate(backend.results(do, open_jobs()), start=1):
        yield result
        if progress:
            progress(kept + number, total, note(result))


@dataclass(frozen=True)
class Attempt(Generic[R]):
    """A call that may have failed.

    Attributes:
        value: what it returned, None if it failed.
        seconds: wall time [s].
    """

    value: R | None
    raised: Exception | None
    seconds: float

    @property
    def error(self) -> str:
        """The exception as one line, with its type where it is none of this package; empty if there is none."""
        known = self.raised is None or isinstance(self.raised, HystmpcError)
        text = str(self.raised or "") if known else f"{type(self.raised).__name__}: {self.raised}"
        return " ".join(text.split())


def attempt(call: Callable[[], R]) -> Attempt[R]:
    """Make a call whose failure must not cost the other jobs their time.

    Raises:
        KeyboardInterrupt: if the user ended it; half a job is no result.
    """
    start = time.perf_counter()
    try:
        value = call()
    except FitInterruptedError:
        raise KeyboardInterrupt from None
    except Exception as raised:  # noqa: BLE001  # one job's defect must not cost the others hours
        return Attempt(None, raised, time.perf_counter() - start)
    return Attempt(value, None, time.perf_counter() - start)


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
            for result in backend.results(do, rest):
                results[result.job.key] = result
                spent += costs.get(result.job.key, 0.0)
                tell(result.job.key if result.status == "done" else f"{result.job.key} failed")
        return tuple(results[job.key] for job in jobs)


def resumed_folder(path: Path, settings: Mapping[str, Any], seed: int, refusal: Callable[[Any], str]) -> RunFolder:
    """A new run folder, or the one in which the same work was begun; its settings are written anew.

    Args:
        refusal: why a folder with these earlier settings cannot be gone on with; empty where it can.

    Raises:
        ConfigError: if the folder holds something else.
        LogError: if it holds a run of another format.
    """
    if not (path / "meta.json").exists():
        return RunFolder.create(path, settings, seed=seed)
    folder = RunFolder.open(path)
    if reason := refusal(folder.config()):
        raise ConfigError(f"{path}: {reason}")
    write_atomically(path / "config.yaml", dump_yaml(dict(settings)))
    return folder


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """One process at a time writes into a folder; the lock of a process that died does not hold.

    Raises:
        ConfigError: if another process works in it.
    """
    lock = FileLock(folder / ".lock", timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise ConfigError(f"{folder}: another process works in it, expected to be alone") from None
    try:
        yield
    finally:
        lock.release()


def wall_minutes(costs: Mapping[str, float], workers: int) -> int:
    """Wall time of jobs of these costs [s] on so many workers, rounded up; never less than the longest job [min]."""
    longest = max(costs.values(), default=0.0)
    return math.ceil(max(sum(costs.values()) / workers, longest) / 60)


def backend_for(workers: int, cluster: str | None = None, where: str = "") -> Backend:
    """The back end that a command line asks for.

    Args:
        workers: processes, each on one thread; with 1 and no cluster the calls are made in this process.
        cluster: address of a Dask scheduler such as `tcp://host:8786`; None or `local` for processes of this machine,
            which talk through pipes: a scheduler of our own would listen, and run what anybody on the machine sends it.

    Raises:
        ConfigError: if the address is none, or Dask is not installed.
    """
    if cluster is None or cluster == "local":
        return InTurn() if workers == 1 else Processes(workers, where)
    if "://" not in cluster:
        raise ConfigError(f"--cluster {cluster}: expected `local` or an address such as tcp://host:8786")
    try:
        from .dask_ import DaskCluster
    except ModuleNotFoundError as error:
        raise ConfigError(f"--cluster {cluster}: {error.name} is not installed: pip install 'hystmpc[tune]'") from None
    return DaskCluster(cluster, where)

"""Calls of one function for many jobs, in this process, in a pool of processes or on a cluster."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic

from hystmpc.trials.errors import ConfigError, FitInterruptedError, HystmpcError
from hystmpc.trials.types import Progress

from .backend import Backend, InTurn, Processes, R, T


def run_jobs(
    function: Callable[[T], R],
    jobs: Iterable[T],
    backend: Backend,
    *,
    is_done: Callable[[T], bool] = lambda job: False,
    total: int | None = None,
    progress: Progress | None = None,
    note: Callable[[R], str] = lambda result: "",
) -> Iterator[R]:
    """Results of the jobs that are not done yet, as they come, in any order.

    A job whose worker dies is done again. An error of `function` ends all; see `attempt` for jobs that may fail.

    Args:
        function: does one job; of a module, so that another process finds it.
        jobs: taken as they are needed, a few ahead of the workers; each can be pickled.
        is_done: whether a job was done by an earlier call.
        total: number of jobs, for `progress`; it is not called where left out.
        progress: called after every job; jobs done earlier count.
        note: text for `progress`.

    Raises:
        ConfigError: if workers die again and again, or there are none.
        KeyboardInterrupt: if the user ended it; the workers are gone by then.
    """
    kept = 0

    def open_jobs() -> Iterator[T]:
        nonlocal kept
        for job in jobs:
            if is_done(job):
                kept += 1
            else:
                yield job

    for number, result in enumerate(backend.results(function, open_jobs()), start=1):
        yield result
        if progress and total is not None:
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

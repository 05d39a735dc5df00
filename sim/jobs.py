"""Execution of one function for many jobs: in this process, in a pool of processes, or on a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain, islice
from typing import Any, Generic, TypeVar, final

from threadpoolctl import threadpool_limits

from hystmpc.trials.errors import ConfigError, FitInterruptedError, HystmpcError
from hystmpc.trials.types import Progress

T = TypeVar("T")
R = TypeVar("R")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_DEATHS = 3  # in a row, without a result between them
_AHEAD = 2  # items per worker that are sent in advance
_TIMEOUT_S = 10.0
_CALLS_AHEAD = 4  # calls per worker thread that the scheduler holds
_LEAST_AHEAD = 64  # so that later workers get items
_ONE_AT_A_TIME = threading.Lock()


class Backend(ABC):
    """Executor of one function for many items; every item gives one result, even if its worker dies repeatedly."""

    def check(self) -> None:  # noqa: B027  # only what is elsewhere can be missing
        """Check that workers are available, before anything is written.

        Raises:
            ConfigError: if they are not.
        """

    @abstractmethod
    def results(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Return results in the order of completion.

        Args:
            function: of a module, so that another process can import it.
            items: taken when needed, a few ahead of the workers; each can be pickled.

        Raises:
            ConfigError: if workers die repeatedly, or there are none.
            KeyboardInterrupt: if the user ended it; the workers are gone by then.
        """


@final
class InTurn(Backend):
    """Executor in this process, on one thread, one call after the other."""

    def results(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        with threadpool_limits(limits=1):
            for item in items:
                yield function(item)


@final
class Processes(Backend):
    """Executor with a pool of processes, one thread each."""

    def __init__(self, workers: int, where: str = "") -> None:
        self.workers = workers
        self._where = where

    def results(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Return results in the order of completion, see `Backend`.

        Raises:
            ConfigError: if workers died three times without a result between.
        """
        rest, deaths = iter(items), 0
        while True:
            pending: dict[Future[R], T] = {}
            try:
                for result in self._until_broken(function, rest, pending):
                    deaths = 0
                    yield result
                return
            except BrokenProcessPool:
                deaths += 1
                if deaths > _DEATHS:
                    raise ConfigError(
                        f"{self._where}: worker processes died {deaths} times without a result (out of memory?); "
                        "the same command goes on, with fewer --jobs"
                    ) from None
                # The call that has killed its worker is unknown; none of these has given its result yet.
                rest = chain(list(pending.values()), rest)

    def _until_broken(self, function: Callable[[T], R], items: Iterator[T], pending: dict[Future[R], T]) -> Iterator[R]:
        """Results until the pool breaks; `pending` holds the items without a result."""
        # Not forked: torch's threads do not survive a fork.
        context = multiprocessing.get_context("spawn")
        with _safe_path():
            pool = ProcessPoolExecutor(self.workers, context, prepare_worker)
            yield from self._asked(pool, function, items, pending)

    def _asked(
        self, pool: ProcessPoolExecutor, function: Callable[[T], R], items: Iterator[T], pending: dict[Future[R], T]
    ) -> Iterator[R]:
        ours = set(multiprocessing.active_children())
        try:
            while True:
                for item in islice(items, _AHEAD * self.workers - len(pending)):
                    pending[_submitted(pool, function, item)] = item
                if not pending:
                    break
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    del pending[future]
                    yield result
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in set(multiprocessing.active_children()) - ours:
                child.terminate()
            raise
        pool.shutdown()


@contextmanager
def _safe_path() -> Iterator[None]:
    """Context in which new workers, whose Python would search the working folder first, import no modules from it."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = before or "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop("PYTHONSAFEPATH", None)


def _submitted(pool: ProcessPoolExecutor, function: Callable[[T], R], item: T) -> Future[R]:
    """Future of a call, already failed if the pool is broken."""
    try:
        return pool.submit(function, item)
    except BrokenProcessPool as error:
        future: Future[R] = Future()
        future.set_exception(error)
        return future


def prepare_worker() -> None:
    """Limit the worker to one thread, and ignore Ctrl-C, which is for the main process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(dict.fromkeys(THREADS, "1"))  # for libraries that are loaded later
    threadpool_limits(limits=1)


@final
class DaskCluster(Backend):
    """Executor on a running Dask cluster.

    Workers need this package, and model files where the settings name them. `address` is that of a scheduler, such as
    `tcp://host:8786`; `tls://` with the certificates of Dask's configuration.
    """

    def __init__(self, address: str, where: str = "") -> None:
        self._address, self._where = address, where

    def check(self) -> None:
        with self._client():
            pass

    def results(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Return results in the order of completion, see `Backend`.

        Raises:
            ConfigError: if no scheduler answers, or a call has killed its workers four times.
        """
        from distributed import as_completed
        from distributed.scheduler import KilledWorker

        with self._client() as client:
            rest = iter(items)
            threads: Any = client.nthreads()  # a coroutine only for clients that were asked to be one
            ahead = max(_LEAST_AHEAD, _CALLS_AHEAD * sum(threads.values()))
            completed = as_completed()
            for item in islice(rest, ahead):
                completed.add(client.submit(alone, function, item, pure=False))
            for future in completed:
                try:
                    result = future.result()
                except KilledWorker as error:
                    raise ConfigError(
                        f"{self._where}: workers died over one call again and again, the last was "
                        f"{error.last_worker.address} (out of memory?); the same command goes on"
                    ) from None
                future.release()
                for item in islice(rest, 1):
                    completed.add(client.submit(alone, function, item, pure=False))
                yield result

    @contextmanager
    def _client(self) -> Iterator[Any]:
        """Connection to the scheduler; a `ConfigError` if none answers."""
        from distributed import Client

        try:
            client = Client(self._address, timeout=_TIMEOUT_S)
        except (OSError, ValueError) as error:  # a timeout is an OSError
            reason = " ".join(str(error).split()) or type(error).__name__
            raise ConfigError(f"--cluster {self._address}: no Dask scheduler answers ({reason})") from None
        with client:
            yield client


def alone(function: Callable[[T], R], item: T) -> R:
    """Call `function` on one thread without parallel calls in this process, however many threads the worker has."""
    with _ONE_AT_A_TIME, threadpool_limits(limits=1):
        os.environ.update(dict.fromkeys(THREADS, "1"))
        return function(item)


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
    """Execute the jobs that are not done yet; results are in the order of completion.

    A job whose worker dies is repeated. An error of `function` ends all; see `attempt` for jobs that may fail. Errors
    and `function` are those of `Backend.results`.

    Args:
        total: number of jobs; `progress` is called only if it is given.
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
    """Result of a call that may have failed: value (None after a failure) and wall time [s]."""

    value: R | None
    raised: Exception | None
    seconds: float

    @property
    def error(self) -> str:
        """Exception as one line, with its type if it is external to this package; empty without one."""
        known = self.raised is None or isinstance(self.raised, HystmpcError)
        text = str(self.raised or "") if known else f"{type(self.raised).__name__}: {self.raised}"
        return " ".join(text.split())


def attempt(call: Callable[[], R]) -> Attempt[R]:
    """Return the result of a call; its failure must not end the other jobs.

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
    """Return the executor for a number of processes, each on one thread; 1 without a cluster means this process.

    `cluster` is the address of a Dask scheduler such as `tcp://host:8786`. None or `local` stands for processes of this
    machine, which use pipes: a local scheduler would execute code from any user of the machine.

    Raises:
        ConfigError: if the address is invalid, or Dask is not installed.
    """
    if cluster is None or cluster == "local":
        return InTurn() if workers == 1 else Processes(workers, where)
    if "://" not in cluster:
        raise ConfigError(f"--cluster {cluster}: expected `local` or an address such as tcp://host:8786")
    if find_spec("distributed") is None:
        raise ConfigError(f"--cluster {cluster}: distributed is not installed: pip install 'hystmpc[tune]'")
    return DaskCluster(cluster, where)

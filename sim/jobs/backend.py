"""Where many calls of one function are made: results as they come, lost workers replaced."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import chain, islice
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext
from multiprocessing.process import BaseProcess
from typing import TypeVar, final

from threadpoolctl import threadpool_limits

from hystmpc.models.kernels.compiling import PROCESS, Compilation, joint
from hystmpc.trials.errors import ConfigError

T = TypeVar("T")
R = TypeVar("R")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_DEATHS = 3  # in a row, without a result between them
_LISTENS_S = 0.2  # between two looks at whether the workers are gone
_AHEAD = 2  # items a worker that are handed over before they are needed


class Backend(ABC):
    """Calls one function for many items; every item gives one result, however often its worker dies on the way."""

    def check(self) -> None:  # noqa: B027  # only what is elsewhere can be missing
        """Find out before anything is written whether there is anybody to work.

        Raises:
            ConfigError: if there is not.
        """

    @abstractmethod
    def results(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Results as they come, in any order.

        Args:
            function: of a module, so that another process finds it.
            items: taken as they are needed, a few ahead of the workers; each can be pickled.

        Raises:
            ConfigError: if workers die again and again, or there are none.
            KeyboardInterrupt: if the user ended it; the workers are gone by then.
        """


@final
class InTurn(Backend):
    """One call after the other in this process, on one thread."""

    def results(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """See `Backend`."""
        with threadpool_limits(limits=1):
            for item in items:
                yield function(item)


@final
class Processes(Backend):
    """A process pool, one thread a process."""

    def __init__(self, workers: int, where: str = "") -> None:
        self.workers = workers
        self._where = where

    def results(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """See `Backend`.

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
                # Which call has killed its worker nobody knows; none of these has given its result yet.
                rest = chain(list(pending.values()), rest)

    def _until_broken(self, function: Callable[[T], R], items: Iterator[T], pending: dict[Future[R], T]) -> Iterator[R]:
        """Results of one pool; `pending` holds what has been asked for and not given.

        Raises:
            BrokenProcessPool: if a worker died.
        """
        # Not forked: torch's and numba's threads do not survive a fork.
        context = multiprocessing.get_context("spawn")
        with _safe_path(), _compilation_told(context) as told:
            pool = ProcessPoolExecutor(self.workers, context, prepare_worker, (told,))
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
            _end(set(multiprocessing.active_children()) - ours)
            raise
        pool.shutdown()


@contextmanager
def _safe_path() -> Iterator[None]:
    """While workers are started: a file of the working folder takes the place of no module in them.

    A worker is a Python of its own with a command for it to read, which would look into the working folder first.
    """
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = before or "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop("PYTHONSAFEPATH", None)


@contextmanager
def _compilation_told(context: SpawnContext) -> Iterator[Connection]:
    """Where workers say what they compile; this process tells its own observers."""
    ears, mouth = context.Pipe(duplex=False)
    over, found = threading.Event(), dict[int, Compilation]()

    def listen() -> None:
        while not over.is_set():
            if ears.poll(_LISTENS_S):
                worker, told = ears.recv()
                found[worker] = told
                PROCESS.tell(joint(found.values()))

    listener = threading.Thread(target=listen, name="compilation of workers", daemon=True)
    listener.start()
    try:
        yield mouth
    finally:
        over.set()
        listener.join()
        if found:
            PROCESS.tell(replace(joint(found.values()), busy=False))  # whatever a worker was at, it is gone
        mouth.close()
        ears.close()


def _submitted(pool: ProcessPoolExecutor, function: Callable[[T], R], item: T) -> Future[R]:
    """The call's future, broken already where the pool is."""
    try:
        return pool.submit(function, item)
    except BrokenProcessPool as error:
        future: Future[R] = Future()
        future.set_exception(error)
        return future


def _end(children: Iterable[BaseProcess]) -> None:
    for child in children:
        child.terminate()


def prepare_worker(told: Connection | None = None) -> None:
    """One thread; Ctrl-C is the main process's business, a fit that heard it would pass for a finished one.

    Args:
        told: where to say what is compiled. A line is shorter than what a pipe takes whole, so that workers share it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(dict.fromkeys(THREADS, "1"))  # for libraries that are loaded later
    threadpool_limits(limits=1)
    if told is not None:

        def tell(found: Compilation) -> None:
            with suppress(OSError):  # nobody listens any more
                told.send((os.getpid(), found))

        PROCESS.observers.append(tell)

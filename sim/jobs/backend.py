"""Where many calls of one function are made: results as they come, lost workers replaced."""

from __future__ import annotations

import multiprocessing
import os
import signal
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import chain, islice
from multiprocessing.process import BaseProcess
from typing import TypeVar, final

from threadpoolctl import threadpool_limits

from hystmpc.trials.errors import ConfigError

T = TypeVar("T")
R = TypeVar("R")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_DEATHS = 3  # in a row, without a result between them
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
        with _safe_path():
            yield from self._asked(function, items, pending)

    def _asked(self, function: Callable[[T], R], items: Iterator[T], pending: dict[Future[R], T]) -> Iterator[R]:
        ours = set(multiprocessing.active_children())
        # Not forked: torch's and numba's threads do not survive a fork.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(self.workers, mp_context=context, initializer=prepare_worker)
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


def prepare_worker() -> None:
    """One thread; Ctrl-C is the main process's business, a fit that heard it would pass for a finished one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(dict.fromkeys(THREADS, "1"))  # for libraries that are loaded later
    threadpool_limits(limits=1)

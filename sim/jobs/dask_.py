"""A Dask cluster that runs already; its scheduler replaces what a lost worker was doing."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any, final

from distributed import Client, as_completed
from distributed.scheduler import KilledWorker
from threadpoolctl import threadpool_limits

from hystmpc.trials.errors import ConfigError

from .backend import THREADS, Backend, R, T

_TIMEOUT_S = 10.0
_AHEAD = 4  # calls a worker thread that the scheduler has in hand
_LEAST_AHEAD = 64  # so that workers that join later find something to do
_ONE_AT_A_TIME = threading.Lock()


@final
class DaskCluster(Backend):
    """A Dask cluster. Workers need this package, and model files where the settings name them.

    Args:
        address: of a scheduler, such as `tcp://host:8786`; `tls://` with the certificates that Dask is configured with.
    """

    def __init__(self, address: str, where: str = "") -> None:
        self._address, self._where = address, where

    def check(self) -> None:
        """See `Backend`.

        Raises:
            ConfigError: if no scheduler answers.
        """
        with self._client():
            pass

    def results(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """See `Backend`.

        Raises:
            ConfigError: if no scheduler answers, or a call has killed its workers four times.
        """
        with self._client() as client:
            rest = iter(items)
            threads: Any = client.nthreads()  # a coroutine only for clients that were asked to be one
            ahead = max(_LEAST_AHEAD, _AHEAD * sum(threads.values()))
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
    def _client(self) -> Iterator[Client]:
        """A connection.

        Raises:
            ConfigError: if no scheduler answers.
        """
        try:
            client = Client(self._address, timeout=_TIMEOUT_S)
        except (OSError, ValueError) as error:  # a timeout is an OSError
            reason = " ".join(str(error).split()) or type(error).__name__
            raise ConfigError(f"--cluster {self._address}: no Dask scheduler answers ({reason})") from None
        with client:
            yield client


def alone(function: Callable[[T], R], item: T) -> R:
    """The call on one thread, and no other call beside it in this process, however many threads the worker has."""
    with _ONE_AT_A_TIME, threadpool_limits(limits=1):
        os.environ.update(dict.fromkeys(THREADS, "1"))
        return function(item)

"""Where many calls of one function are made: results as they come, lost workers replaced."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar, final

from threadpoolctl import threadpool_limits

from hystmpc.trials.errors import ConfigError

T = TypeVar("T")
R = TypeVar("R")

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


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


def backend_for(workers: int, cluster: str | None = None, where: str = "") -> Backend:
    """The back end that a command line asks for.

    Args:
        workers: processes, each on one thread; with 1 and no cluster the calls are made in this process.
        cluster: address of a Dask scheduler such as `tcp://host:8786`; None or `local` for processes of this machine,
            which talk through pipes: a scheduler of our own would listen, and run what anybody on the machine sends it.
        where: what is worked on, for messages.

    Raises:
        ConfigError: if the address is none, or Dask is not installed.
    """
    if cluster is None or cluster == "local":
        from .processes import Processes

        return InTurn() if workers == 1 else Processes(workers, where)
    if "://" not in cluster:
        raise ConfigError(f"--cluster {cluster}: expected `local` or an address such as tcp://host:8786")
    try:
        from .dask_ import DaskCluster
    except ModuleNotFoundError as error:
        raise ConfigError(f"--cluster {cluster}: {error.name} is not installed: pip install 'hystmpc[tune]'") from None
    return DaskCluster(cluster, where)

"""On how many threads a roll-out may run, and the threads for it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

from threadpoolctl import ThreadpoolController


def allowed_threads() -> int:
    """Threads that the process gives its BLAS now, at most one a core.

    One number for all that multiplies matrices: whoever limits BLAS (`threadpoolctl`, OMP_NUM_THREADS), as the control
    loop and the workers of a study do, limits this too.
    """
    given = [library.num_threads for library in _blas().lib_controllers]
    return max(1, min([_cores(), *given])) if given else 1


def share(work: Callable[[int, int], None], spans: Iterable[tuple[int, int]], threads: int) -> None:
    """work(begin, end) for every span on `threads` threads, this one among them; who is done takes the next span.

    Python's own threads, which sleep while there is nothing to do: `work` has to leave the interpreter's lock.
    """
    left = iter(list(spans))

    def take() -> None:
        for begin, end in left:
            work(begin, end)

    others = [_pool(os.getpid(), threads - 1).submit(take) for _ in range(threads - 1)]
    take()
    for other in others:
        other.result()


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


@lru_cache(maxsize=4)
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Of this process: a fork has none of its parent's threads."""
    return ThreadPoolExecutor(threads, thread_name_prefix=f"hystmpc-rollout-{process}")


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

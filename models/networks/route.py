"""Predictions of one recurrent network in single precision, by the engine; roll-outs on several threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise
from typing import final

import numpy as np
from threadpoolctl import ThreadpoolController

from hystmpc.core.library import HoldsAddresses, engine
from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from .packed import NetworkWeights, pack_network

_LEAST_ROWS = 48  # of a thread: waking one takes as long as a few of them
_SPANS = 4  # of each thread: one that is interrupted leaves the rest to the others
_WHOLE = 12  # rows: whole blocks of rows at every level of the engine


@final
class NetworkRoute(HoldsAddresses):
    """Predictions of one network; state (S,) as in its model file, everything finite.

    The gates of some networks would turn not-a-number into a plausible angle: callers check. A plan's angles do not
    depend, to the last bit, on the plans beside it, on the number of threads, and on the processor.

    Args:
        weights: of any width.
        threads: asked before every roll-out how many it may use.
        level: of the engine's vector instructions, for tests; the best one of this processor where left out.

    Attributes:
        name: for tables.
        packed: weights as the engine reads them.
        address: of the packed weights, for the engine.
        functions: of the engine at this level, for which the weights are packed.
        weights: as they were given.
        states: number of entries of a state.

    Raises:
        ModelError: by each method, if the state is of another size.
    """

    def __init__(
        self, weights: NetworkWeights, threads: Callable[[], int] | None = None, level: str | None = None
    ) -> None:
        self.functions, self._threads = engine(level), threads or allowed_threads
        self.weights = weights
        lanes = self.functions.network_lanes()
        self.name, self.packed = f"vectors of {lanes}", pack_network(weights, lanes)
        self.address = self.packed.ctypes.data
        self.states = int(self.functions.network_state(self.address))
        self._one = self.functions.network_room(self.address, 1)
        self._together = self.functions.network_together()

    def at_best_level(self) -> NetworkRoute:
        """The network packed for the best level of this processor."""
        best = engine().network_lanes() == self.functions.network_lanes()
        return self if best else NetworkRoute(self.weights, self._threads)

    def advance(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        """Angles (K,) [deg] along the plan (K,) [command unit] and the state behind it."""
        size, end = self.states, self.states + plan.size
        motion = np.empty(end + self._one)
        motion[:size], motion[size:end] = self._checked(state), plan
        self.functions.network_advance(self.address, motion, plan.size)
        return motion[size:end], motion[:size]

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        """Angles (N, K) [deg] of the plans (N, K)."""
        angles, count, samples = np.empty(plans.shape), len(plans), plans.shape[1]
        state, plans = _copied(self._checked(state)), _copied(plans)
        room = self.functions.network_room(self.address, min(count, self._together))

        def roll(begin: int, end: int) -> None:
            rows = slice(begin, end)
            given = self.address, state, plans[rows], end - begin, samples, angles[rows], np.empty(room)
            self.functions.network_rollout(*given)

        most = count // _LEAST_ROWS
        threads = min(self._threads(), most) if most > 1 else 1  # asking takes as long as a row
        if threads > 1:
            share(roll, _spans(count, threads), threads)
        elif count:
            roll(0, count)
        return angles

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        """Angles (K,) [deg] along the plan (K,) and their derivatives (K, K) by its commands, lower triangular."""
        angles, jacobian = np.empty(plan.size), np.zeros((plan.size, plan.size))
        work = np.empty(self.functions.network_room(self.address, 1 + plan.size))
        given = self.address, _copied(self._checked(state)), _copied(plan), plan.size
        self.functions.network_linearise(*given, angles, jacobian, work)
        return angles, jacobian

    def _checked(self, state: Vec) -> Vec:
        """The engine does not look where memory ends."""
        if state.shape != (self.states,):
            raise ModelError(f"network state: got shape {state.shape}, expected ({self.states},)")
        return state


def _copied(values: Vec) -> Vec:
    """A contiguous copy; the caller's may be strided or read-only."""
    return np.array(values, dtype=np.float64, order="C")


def _spans(count: int, threads: int) -> list[tuple[int, int]]:
    """Rows 0 to `count` in even parts, whole blocks as far as they go."""
    blocks = -(-count // _WHOLE)
    parts = min(blocks, _SPANS * threads)
    return list(pairwise(min(count, _WHOLE * (blocks * k // parts)) for k in range(parts + 1)))


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

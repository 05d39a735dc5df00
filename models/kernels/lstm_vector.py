"""The vector route: everything by the vector kernel."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import final

import numpy as np

from hystmpc.trials.errors import ModelError

from ..lstm.weights import LstmWeights
from .network_route import Array, NetworkRoute
from .threads import allowed_threads, share
from .vector_kernels import pack_panels, vector_kernels
from .vector_shape import VectorShape

_LEAST_ROWS = 48  # of a thread: waking one takes as long as a few of them
_SPANS = 4  # of each thread: one that is interrupted leaves the rest to the others


@final
class VectorRoute(NetworkRoute):
    """Steps, roll-outs and Jacobians by the vector kernel, roll-outs on as many threads as the process gives BLAS.

    A plan's angles do not depend, to the last bit, on the plans beside it and on the number of threads. Making one
    compiles the kernels, or reads them from the cache: nothing is compiled later.

    Args:
        weights: of any width; it is filled up to a multiple of the lanes.
        shape: lanes and rows; one that the processor does not have is slow but right.
        threads: asked before every roll-out how many it may use.

    Raises:
        ModelError: by each method, if the state is of another size.
    """

    def __init__(self, weights: LstmWeights, shape: VectorShape, threads: Callable[[], int] = allowed_threads) -> None:
        self.name = f"vectors of {shape.lanes}, {shape.rows} rows"
        self._kernels, self.packed = vector_kernels(shape), pack_panels(weights, shape.lanes)
        self.sample = self._kernels.sample
        self._rows, self._threads, self._size = shape.rows, threads, weights.state_size

    def advance(self, state: Array, plan: Array) -> tuple[Array, Array]:
        angles, following = np.empty((1, plan.size)), np.empty((1, state.size))
        self._kernels.rollout(self.packed, self._state(state), _own(plan)[None], 0, 1, angles, following)
        return angles[0], following[0]

    def rollout(self, state: Array, plans: Array) -> Array:
        angles, nothing = np.empty(plans.shape), np.empty((0, state.size))
        count, state, plans = len(plans), self._state(state), _own(plans)

        def roll(begin: int, end: int) -> None:
            self._kernels.rollout(self.packed, state, plans, begin, end, angles, nothing)

        most = count // _LEAST_ROWS
        threads = min(self._threads(), most) if most > 1 else 1  # asking takes as long as a row
        if threads > 1:
            share(roll, self._spans(count, threads), threads)
        elif count:
            roll(0, count)
        return angles

    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        angles, jacobian = np.empty(plan.size), np.zeros((plan.size, plan.size))
        self._kernels.linearise(self.packed, self._state(state), _own(plan), angles, jacobian)
        return angles, jacobian

    def _state(self, state: Array) -> Array:
        """Own copy of a state; the kernels do not look where memory ends."""
        if state.shape != (self._size,):
            raise ModelError(f"LSTM state: got shape {state.shape}, expected ({self._size},)")
        return _own(state)

    def _spans(self, count: int, threads: int) -> list[tuple[int, int]]:
        """Rows 0 to `count` in even parts, whole blocks of the kernel's rows as far as they go."""
        blocks = -(-count // self._rows)
        parts = min(blocks, _SPANS * threads)
        edges = [min(count, self._rows * (blocks * k // parts)) for k in range(parts + 1)]
        return list(pairwise(edges))


def _own(values: Array) -> Array:
    """A copy of the one layout that the kernels are compiled for; the caller's may be strided or read-only."""
    return np.array(values, dtype=np.float64, order="C")

"""The vector route of a stacked LSTM or GRU: the vector kernel, compiled for this processor, on several threads."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable
from itertools import pairwise
from types import ModuleType
from typing import NamedTuple, final

import numpy as np
from threadpoolctl import ThreadpoolController

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..networks.lstm import LstmWeights
from .network_route import Float32, NetworkRoute
from .numba_ import generated_module
from .vector_emitter import CELLS, VectorShape

_HEADER = """# emitter {digest}
from hystmpc.models.kernels.vector_emitter import CELLS, Rows, VectorShape, block_intrinsic

LANES, ROWS, CELL = {lanes}, {rows}, CELLS["{cell}"]
PARTS = CELL.parts
motions, first, tangents = (block_intrinsic(kind, VectorShape(LANES, ROWS), CELL) for kind in Rows)


"""
_LINE = 64  # bytes of a cache line


class PackedPanels(NamedTuple):
    """Weights as the vector kernel reads them: in the order of its loads; widths filled up with cells that stay zero.

    Attributes:
        weights: (L, U / lanes, (1 + 2 U) 4 lanes): per panel the bias, then one input after the other, each four gates
            of `lanes` units, sigmoid gates halved; the first layer uses the first 1 + 1 + U of these rows.
        head: (U,).
        head_bias: scalar.
        scaling: u_offset, u_scale, theta_offset, theta_scale.
        hidden: H <= U, units of the model.
    """

    weights: Float32
    head: Float32
    head_bias: float
    scaling: Vec
    hidden: int


@dataclass(frozen=True)
class VectorKernels:
    """Compiled functions; see `vector_loops` for their arguments."""

    rollout: Callable[..., None]
    linearise: Callable[..., None]
    sample: Callable[..., None]


@lru_cache(maxsize=4)
def vector_kernels(shape: VectorShape, cell: str = "lstm") -> VectorKernels:
    """Functions for vectors of this shape: compiled, or read from numba's cache, before this returns."""
    module = generated_module(kernel_source(shape, resources.files("hystmpc.models.kernels"), cell))
    _compile(module, shape.lanes)
    return VectorKernels(module.rollout, module.linearise, module.sample)


def kernel_source(shape: VectorShape, folder: Traversable, cell: str = "lstm") -> str:
    """Text of the module for this shape, from the files in `folder`.

    The hash of the emitter is part of it, and thereby of the name of the module: an intrinsic is not part of the digest
    of its callers (`source_digest`).
    """
    digest = hashlib.sha256(folder.joinpath("vector_emitter.py").read_bytes()).hexdigest()[:24]
    header = _HEADER.format(digest=digest, lanes=shape.lanes, rows=shape.rows, cell=cell)
    return header + folder.joinpath("vector_loops.py").read_text(encoding="utf-8")


def _compile(module: ModuleType, lanes: int) -> None:
    """Call each function once, on a network without weights, and forbid to compile for other types of arguments."""
    nothing = np.zeros((1, 1, (1 + 2 * lanes) * 4 * lanes), np.float32)
    packed = PackedPanels(nothing, np.zeros(lanes, np.float32), 0.0, np.ones(4), lanes)
    state, plans = np.zeros(module.PARTS * lanes), np.zeros((1, 1))
    module.rollout(packed, state, plans, 0, 1, np.empty((1, 1)), np.empty((1, state.size)))
    module.linearise(packed, state, plans[0], np.empty(1), np.empty((1, 1)))
    for function in (module.rollout, module.linearise):
        function.disable_compile()


def pack_panels(weights: LstmWeights, lanes: int, cell: str = "lstm") -> PackedPanels:
    """Arrange weights for vectors of `lanes` numbers; sigmoid(z) = 1/2 + 1/2 tanh(z/2), the inner half goes in here."""
    hidden, count = weights.hidden, len(weights.layers)
    units = -(-hidden // lanes) * lanes
    half = np.array(CELLS[cell].halves)
    table = np.zeros((count, 1 + 2 * units, 4, units))
    for layer, own in zip(weights.layers, table, strict=True):
        below = layer.inputs if layer.inputs == 1 else units
        parts = [(0, layer.bias[:, None]), (1, layer.w_ih), (1 + below, layer.w_hh)]
        for start, part in parts:
            gates = part.T.reshape(-1, 4, hidden) * half[:, None]
            own[start : start + len(gates), :, :hidden] = gates
    panels = table.reshape(count, 1 + 2 * units, 4, units // lanes, lanes).transpose(0, 3, 1, 2, 4)
    head = np.zeros(units, np.float32)
    head[:hidden] = weights.head_weight
    s = weights.scaling
    return PackedPanels(
        _aligned(panels.reshape(count, units // lanes, -1)),
        head,
        float(weights.head_bias),
        np.array([s.u_offset, s.u_scale, s.theta_offset, s.theta_scale]),
        hidden,
    )


def _aligned(values: Vec) -> Float32:
    """A float32 copy that starts at a cache line: a vector then never lies across two."""
    memory = np.empty(values.size + _LINE // 4, np.float32)
    skip = (-memory.ctypes.data % _LINE) // 4
    out = memory[skip : skip + values.size].reshape(values.shape)
    out[:] = values
    return out


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
        cell: `lstm`, or `gru` with `gru_weights`.

    Raises:
        ModelError: by each method, if the state is of another size.
    """

    def __init__(
        self,
        weights: LstmWeights,
        shape: VectorShape,
        threads: Callable[[], int] = allowed_threads,
        cell: str = "lstm",
    ) -> None:
        self.name = f"vectors of {shape.lanes}, {shape.rows} rows"
        self._kernels, self.packed = vector_kernels(shape, cell), pack_panels(weights, shape.lanes, cell)
        self.sample = self._kernels.sample
        self._rows, self._threads = shape.rows, threads
        self._size = CELLS[cell].parts * len(weights.layers) * weights.hidden

    def advance(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        angles, following = np.empty((1, plan.size)), np.empty((1, state.size))
        self._kernels.rollout(self.packed, self._state(state), _own(plan)[None], 0, 1, angles, following)
        return angles[0], following[0]

    def rollout(self, state: Vec, plans: Vec) -> Vec:
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

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        angles, jacobian = np.empty(plan.size), np.zeros((plan.size, plan.size))
        self._kernels.linearise(self.packed, self._state(state), _own(plan), angles, jacobian)
        return angles, jacobian

    def _state(self, state: Vec) -> Vec:
        """Own copy of a state; the kernels do not look where memory ends."""
        if state.shape != (self._size,):
            raise ModelError(f"network state: got shape {state.shape}, expected ({self._size},)")
        return _own(state)

    def _spans(self, count: int, threads: int) -> list[tuple[int, int]]:
        """Rows 0 to `count` in even parts, whole blocks of the kernel's rows as far as they go."""
        blocks = -(-count // self._rows)
        parts = min(blocks, _SPANS * threads)
        edges = [min(count, self._rows * (blocks * k // parts)) for k in range(parts + 1)]
        return list(pairwise(edges))


def _own(values: Vec) -> Vec:
    """A copy of the one layout that the kernels are compiled for; the caller's may be strided or read-only."""
    return np.array(values, dtype=np.float64, order="C")

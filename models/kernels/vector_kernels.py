"""The vector kernel of a stacked LSTM, compiled for this processor."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..lstm.weights import LstmWeights
from .cache import generated_module
from .vector_shape import VectorShape

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
_EMITTERS = ("vector_code.py", "vector_emitter.py", "vector_gates.py", "vector_shape.py")
_HEADER = """# emitters {digest}
from hystmpc.models.kernels.vector_emitter import Rows, block_intrinsic
from hystmpc.models.kernels.vector_shape import VectorShape

LANES, ROWS = {lanes}, {rows}
motions, first, tangents = (block_intrinsic(kind, VectorShape(LANES, ROWS)) for kind in Rows)


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
    scaling: Array
    hidden: int


@dataclass(frozen=True)
class VectorKernels:
    """Compiled functions; see `vector_loops` for their arguments."""

    rollout: Callable[..., None]
    linearise: Callable[..., None]
    sample: Callable[..., None]


@lru_cache(maxsize=4)
def vector_kernels(shape: VectorShape) -> VectorKernels:
    """Functions for vectors of this shape: compiled, or read from numba's cache, before this returns."""
    module = generated_module(kernel_source(shape, resources.files("hystmpc.models.kernels")))
    _compile(module, shape.lanes)
    return VectorKernels(module.rollout, module.linearise, module.sample)


def kernel_source(shape: VectorShape, folder: Traversable) -> str:
    """Text of the module for this shape, from the files in `folder`.

    The emitters' hash is part of it, and thereby of the module's name: numba's cache looks at a function's own file
    and would go on with the code of an emitter that has changed.
    """
    digest = hashlib.sha256(b"".join(folder.joinpath(name).read_bytes() for name in _EMITTERS)).hexdigest()[:24]
    header = _HEADER.format(digest=digest, lanes=shape.lanes, rows=shape.rows)
    return header + folder.joinpath("vector_loops.py").read_text(encoding="utf-8")


def _compile(module: ModuleType, lanes: int) -> None:
    """Call each function once, on a network without weights, and forbid to compile for other types of arguments."""
    nothing = np.zeros((1, 1, (1 + 2 * lanes) * 4 * lanes), np.float32)
    packed = PackedPanels(nothing, np.zeros(lanes, np.float32), 0.0, np.ones(4), lanes)
    state, plans = np.zeros(2 * lanes), np.zeros((1, 1))
    module.rollout(packed, state, plans, 0, 1, np.empty((1, 1)), np.empty((1, state.size)))
    module.linearise(packed, state, plans[0], np.empty(1), np.empty((1, 1)))
    for function in (module.rollout, module.linearise):
        function.disable_compile()


def pack_panels(weights: LstmWeights, lanes: int) -> PackedPanels:
    """Arrange weights for vectors of `lanes` numbers; sigmoid(z) = 1/2 + 1/2 tanh(z/2), the inner half goes in here."""
    hidden, count = weights.hidden, len(weights.layers)
    units = -(-hidden // lanes) * lanes
    half = np.array([0.5, 0.5, 1.0, 0.5])
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


def _aligned(values: Array) -> Float32:
    """A float32 copy that starts at a cache line: a vector then never lies across two."""
    memory = np.empty(values.size + _LINE // 4, np.float32)
    skip = (-memory.ctypes.data % _LINE) // 4
    out = memory[skip : skip + values.size].reshape(values.shape)
    out[:] = values
    return out

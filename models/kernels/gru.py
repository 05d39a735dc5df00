"""Compiled float32 kernels of a stacked GRU: samples, batches of plans, and the Jacobian by forward sensitivity.

Matrix products through BLAS (`np.dot`), everything between them in loops that LLVM vectorises. With sigmoid gates
halved in the weights, y_r = (W_r x + U_r h + b_r) / 2 and y_z alike (`GruNet`):

    r = 1/2 + 1/2 tanh(y_r),  z = 1/2 + 1/2 tanh(y_z),  n = tanh(a_n + r c_n),  h' = (1 - z) n + z h

Callers check for not-a-number: the gates' clamp would hide it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..networks.lstm import LstmLayer, LstmWeights
from ..networks.nodes import Scaling
from .lstm_plain import add_row, dot_row, rational_tanh
from .network_route import Float32, NetworkRoute
from .numba_ import njit

_CHUNK = 64  # rows at a time, which the second cache holds with the weights
_HALF, _ONE = np.float32(0.5), np.float32(1.0)
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "arcp", "reassoc"}}


class PackedGru(NamedTuple):
    """Weights as the kernels read them: float32, contiguous, one column a gate in the order r, z, n.

    Attributes:
        entry: weights of the scaled command (3H,).
        inputs: input weights of the layers above the first (L - 1, H, 3H).
        recurrent: recurrent weights (L, H, 3H).
        bias: of the input part (L, 3H).
        own: bias of the recurrent part (L, 3H).
        head: (H,).
        head_bias: (1,).
        scaling: u_offset, u_scale, theta_offset, theta_scale; float64.
    """

    entry: Float32
    inputs: Float32
    recurrent: Float32
    bias: Float32
    own: Float32
    head: Float32
    head_bias: Float32
    scaling: NDArray[np.float64]


def gru_weights(arrays: Mapping[str, ArrayLike]) -> LstmWeights:
    """The numbers of an exported GRU as those of four sums a unit, as the vector kernel takes them.

    In the place of gates stand the arguments of r and z, and both parts of n: a_n without own weights, c_n without
    input weights (`GruNet`).

    Raises:
        ModelError: if some are missing.
    """
    packed = pack_gru(arrays)
    hidden, stack = packed.head.size, []
    for k in range(len(packed.recurrent)):
        named = [np.asarray(arrays[f"gru.{k}.{part}"], dtype=np.float64) for part in ("ih.weight", "hh.weight")]
        w_ih, w_hh = (np.concatenate([w, np.zeros((hidden, w.shape[1]))]) for w in named)
        w_hh[3 * hidden :], w_hh[2 * hidden : 3 * hidden] = w_hh[2 * hidden : 3 * hidden].copy(), 0.0
        b_ih, b_hh = (np.asarray(arrays[f"gru.{k}.{side}.bias"], dtype=np.float64) for side in ("ih", "hh"))
        gates = b_ih[: 2 * hidden] + b_hh[: 2 * hidden]
        stack.append(LstmLayer(w_ih, w_hh, np.concatenate([gates, b_ih[2 * hidden :], b_hh[2 * hidden :]])))
    head = packed.head.astype(np.float64)
    return LstmWeights(tuple(stack), head, float(packed.head_bias[0]), Scaling(*packed.scaling.tolist()))


def pack_gru(arrays: Mapping[str, ArrayLike]) -> PackedGru:
    """Arrange the initializers of an exported GRU for the kernels.

    Raises:
        ModelError: if some are missing.
    """
    count = sum(name.startswith("gru.") and name.endswith(".hh.weight") for name in arrays)
    parts = [f"gru.{k}.{side}.{part}" for k in range(count) for side in ("ih", "hh") for part in ("weight", "bias")]
    scaling = [f"scaling.{part}" for part in ("u_offset", "u_scale", "theta_offset", "theta_scale")]
    missing = [n for n in (*parts, "gru.0.ih.weight", "head.weight", "head.bias", *scaling) if n not in arrays]
    if missing:
        raise ModelError(f"GRU: no array {', '.join(missing)}, available: {', '.join(sorted(arrays))}")
    hidden = np.asarray(arrays["gru.0.hh.weight"]).shape[1]
    half = np.repeat([0.5, 0.5, 1.0], hidden)

    def layers(name: str, first: int = 0) -> list[NDArray[np.float64]]:
        return [np.asarray(arrays[f"gru.{k}.{name}"], dtype=np.float64).T * half for k in range(first, count)]

    return PackedGru(
        entry=_single(np.ravel(np.asarray(arrays["gru.0.ih.weight"])) * half),
        inputs=_single(np.reshape(layers("ih.weight", 1), (count - 1, hidden, 3 * hidden))),
        recurrent=_single(np.stack(layers("hh.weight"))),
        bias=_single(np.stack(layers("ih.bias"))),
        own=_single(np.stack(layers("hh.bias"))),
        head=_single(np.ravel(np.asarray(arrays["head.weight"]))),
        head_bias=_single(np.ravel(np.asarray(arrays["head.bias"]))),
        scaling=np.array([float(np.asarray(arrays[name]).item()) for name in scaling]),
    )


def _single(values: ArrayLike) -> Float32:
    return np.array(values, dtype=np.float32, order="C")


@njit(**_OPTIONS)
def cell_row(a: Any, c: Any, h: Any) -> None:
    """h' of one row (H,) from the parts a, c (3H,) of the gates' arguments, biases inside; a is used up."""
    n = h.size
    for j in range(2 * n):
        a[j] = rational_tanh(a[j] + c[j])
    for j in range(n):
        a[2 * n + j] = rational_tanh(a[2 * n + j] + (_HALF + _HALF * a[j]) * c[2 * n + j])
    for j in range(n):
        keep = _HALF + _HALF * a[n + j]
        h[j] = a[2 * n + j] + keep * (h[j] - a[2 * n + j])


@njit(**_OPTIONS)
def factors_row(a: Any, c: Any, h: Any, factors: Any) -> None:
    """What `derivative_row` multiplies with (5, H), and h' as `cell_row`: by dy_r, dy_z, da_n, dc_n, dh."""
    n = h.size
    for j in range(2 * n):
        a[j] = rational_tanh(a[j] + c[j])
    for j in range(n):
        open_ = _HALF + _HALF * a[j]
        new = rational_tanh(a[2 * n + j] + open_ * c[2 * n + j])
        keep = _HALF + _HALF * a[n + j]
        fresh = (_ONE - keep) * (_ONE - new * new)
        factors[0, j] = fresh * c[2 * n + j] * _HALF * (_ONE - a[j] * a[j])
        factors[1, j] = (h[j] - new) * _HALF * (_ONE - a[n + j] * a[n + j])
        factors[2, j] = fresh
        factors[3, j] = fresh * open_
        factors[4, j] = keep
        h[j] = new + keep * (h[j] - new)


@njit(**_OPTIONS)
def derivative_row(a: Any, c: Any, factors: Any, h: Any) -> None:
    """dh' of one row (H,) in place, from the derivatives of both parts of the gates' arguments (3H,)."""
    n = h.size
    for j in range(n):
        h[j] = (
            factors[4, j] * h[j]
            + factors[0, j] * (a[j] + c[j])
            + factors[1, j] * (a[n + j] + c[n + j])
            + factors[2, j] * a[2 * n + j]
            + factors[3, j] * c[2 * n + j]
        )


@njit(**_OPTIONS)
def scale_row(row: Any, factor: Any, other: Any) -> None:
    """row = factor other."""
    for j in range(row.size):
        row[j] = factor * other[j]


@njit(cache=True, error_model="numpy", nogil=True)
def rollout(packed: Any, states: Any, plans: Any, angles: Any) -> None:
    """Scaled angles (N, K) of the scaled plans (N, K); states (L, N, H) are moved on in place."""
    most = min(plans.shape[0], _CHUNK)
    a = np.empty((most, packed.entry.size), np.float32)
    c = np.empty_like(a)
    for start in range(0, plans.shape[0], most):
        rows = min(most, plans.shape[0] - start)
        for k in range(plans.shape[1]):
            for layer in range(len(packed.recurrent)):
                h = states[layer][start : start + rows]
                if layer:
                    np.dot(states[layer - 1][start : start + rows], packed.inputs[layer - 1], a[:rows])
                np.dot(h, packed.recurrent[layer], c[:rows])
                for n in range(rows):
                    if layer == 0:
                        scale_row(a[n], plans[start + n, k], packed.entry)
                    add_row(a[n], packed.bias[layer])
                    add_row(c[n], packed.own[layer])
                    cell_row(a[n], c[n], h[n])
            for n in range(rows):
                angles[start + n, k] = dot_row(packed.head, states[-1][start + n]) + packed.head_bias[0]


@njit(cache=True, error_model="numpy", nogil=True)
def linearise(packed: Any, state: Any, plan: Any, angles: Any, jacobian: Any) -> None:
    """Scaled angles (K,) along the scaled plan (K,) and their derivative (K, K), whose upper part is left alone.

    Row 0 is the motion, row j the derivative by command j - 1, which joins at its own sample.
    """
    count, hidden = plan.size, packed.head.size
    h = np.zeros((len(packed.recurrent), count + 1, hidden), np.float32)
    h[:, 0] = state
    a = np.empty((count + 1, 3 * hidden), np.float32)
    c = np.empty_like(a)
    factors = np.empty((5, hidden), np.float32)
    for k in range(count):
        rows = k + 2
        for layer in range(len(packed.recurrent)):
            if layer:
                np.dot(h[layer - 1][:rows], packed.inputs[layer - 1], a[:rows])
            else:
                a[:rows] = 0.0
                scale_row(a[0], plan[k], packed.entry)
                scale_row(a[k + 1], _ONE, packed.entry)
            np.dot(h[layer][:rows], packed.recurrent[layer], c[:rows])
            add_row(a[0], packed.bias[layer])
            add_row(c[0], packed.own[layer])
            factors_row(a[0], c[0], h[layer, 0], factors)
            for row in range(1, rows):
                derivative_row(a[row], c[row], factors, h[layer, row])
        angles[k] = dot_row(packed.head, h[-1, 0]) + packed.head_bias[0]
        for j in range(k + 1):
            jacobian[k, j] = dot_row(packed.head, h[-1, j + 1])


@njit(cache=True, error_model="numpy", nogil=True)
def sample(packed: Any, states: Any, rows: int, v: Any, theta: Any) -> None:
    """One sample of the first `rows` states (2, S) under commands v (2,), in place; theta (2,) takes the angles."""
    scaling, layers, hidden = packed.scaling, len(packed.recurrent), packed.head.size
    plan, y = np.empty((1, 1), np.float32), np.empty((1, 1), np.float32)
    for row in range(rows):
        table = states[row].astype(np.float32).reshape(layers, 1, hidden)
        plan[0, 0] = (v[row] - scaling[0]) / scaling[1]
        rollout(packed, table, plan, y)
        states[row] = table.ravel()
        theta[row] = scaling[2] + scaling[3] * y[0, 0]


@final
class GruRoute(NetworkRoute):
    """Matrix products of the library, on as many threads as the process gives BLAS.

    Args:
        arrays: initializers of the exported model, see `GruNet.write`.

    Raises:
        ModelError: if some are missing.
    """

    name = "plain"

    def __init__(self, arrays: Mapping[str, ArrayLike]) -> None:
        self.packed, self.sample = pack_gru(arrays), sample
        self._u_offset, self._u_scale, self._offset, self._scale = self.packed.scaling.tolist()
        self._shape = (len(self.packed.recurrent), 1, self.packed.head.size)

    def advance(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        following = np.array(state, dtype=np.float32).reshape(self._shape)
        y = np.empty((1, plan.size), np.float32)
        rollout(self.packed, following, self._scaled(plan)[None], y)
        return self._angles(y[0]), following.ravel().astype(np.float64)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        layer_states = np.repeat(np.array(state, dtype=np.float32).reshape(self._shape), len(plans), axis=1)
        y = np.empty(plans.shape, np.float32)
        rollout(self.packed, layer_states, self._scaled(plans), y)
        return self._angles(y)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        y, by_plan = np.empty(plan.size, np.float32), np.zeros((plan.size, plan.size), np.float32)
        layers = np.array(state, dtype=np.float32).reshape(self._shape[0], self._shape[2])
        linearise(self.packed, layers, self._scaled(plan), y, by_plan)
        return self._angles(y), self._scale / self._u_scale * by_plan.astype(np.float64)

    def _scaled(self, u: Vec) -> Float32:
        return np.ascontiguousarray((u - self._u_offset) / self._u_scale, dtype=np.float32)

    def _angles(self, y: Float32) -> Vec:
        return self._offset + self._scale * y.astype(np.float64)

"""Compiled float32 kernels of an increment-gated LSTM: samples, batches of plans, the Jacobian by forward sensitivity.

Equations in `GatedLstmNet`. A row is [w, p_1 ... p_n, h] (I + H,), I = 1 + n, as one matrix product takes it; the
cells c (H,) stand beside it. Callers check for not-a-number: the gates' clamp would hide it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..networks.lstm import GATED_MARK
from .lstm_plain import cell_row, differentiated_cell_row, dot_row
from .network_route import Float32, NetworkRoute
from .numba_ import njit

_CHUNK = 64  # rows at a time, which the second cache holds with the weights
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "arcp", "reassoc"}}
_ONE = np.float32(1.0)


class PackedGatedLstm(NamedTuple):
    """Weights as the kernels read them: float32, contiguous, one column a gate, sigmoid gates halved.

    Attributes:
        weights: of inputs and outputs (I + H, 4H).
        bias: (4H,).
        head: (I + H,), in the order of a row.
        head_bias: (1,).
        radii: (n,).
        front: k, e and -1 / s (3,); k = 0 without a lag, -1 / s = 0 without the gate.
        scaling: u_offset, u_scale, theta_offset, theta_scale; float64.
    """

    weights: Float32
    bias: Float32
    head: Float32
    head_bias: Float32
    radii: Float32
    front: Float32
    scaling: NDArray[np.float64]


def pack_gated_lstm(arrays: Mapping[str, ArrayLike]) -> PackedGatedLstm:
    """Arrange the initializers of an exported gated LSTM for the kernels.

    Raises:
        ModelError: if some are missing.
    """
    scaling = [f"scaling.{part}" for part in ("u_offset", "u_scale", "theta_offset", "theta_scale")]
    wanted = [f"lstm.0.{part}" for part in ("w_ih", "w_hh", "bias")] + [GATED_MARK, "gated.head.bias", *scaling]
    missing = [name for name in wanted if name not in arrays]
    if missing:
        raise ModelError(f"gated LSTM: no array {', '.join(missing)}, available: {', '.join(sorted(arrays))}")
    w_ih, w_hh, bias, head, head_bias, *units = (np.asarray(arrays[name], dtype=np.float64) for name in wanted)
    hidden = w_hh.shape[1]
    half = np.repeat([0.5, 0.5, 1.0, 0.5], hidden)
    head = np.ravel(head)
    front = [np.asarray(arrays.get(f"gated.{name}", 0.0)).item() for name in ("keep", "settled", "rate")]
    return PackedGatedLstm(
        weights=_single(np.concatenate([w_ih, w_hh], axis=1).T * half),
        bias=_single(bias * half),
        head=_single(np.concatenate([head[hidden:], head[:hidden]])),
        head_bias=_single(np.ravel(head_bias)),
        radii=_single(np.ravel(np.asarray(arrays.get("gated.radii", [])))),
        front=_single(front),
        scaling=np.array([unit.item() for unit in units]),
    )


def _single(values: ArrayLike) -> Float32:
    return np.array(values, dtype=np.float32, order="C")


@njit(cache=True, error_model="numpy", nogil=True)
def follow_front(packed: Any, row: Any, v: Any, moves: Any) -> Any:
    """Lag and plays of one row in place; returns the move w' - w.

    moves (I,) is filled: for the lag the share of v that passes at once, for each play whether it moves.
    """
    keep, settled = packed.front[0], packed.front[1]
    last = row[0]
    w = v
    moves[0] = _ONE
    if keep > 0.0:
        behind = last - v
        left = keep * abs(behind) - settled
        if left > 0.0:
            w = v + np.float32(math.copysign(left, behind))
            moves[0] = _ONE - keep
    row[0] = w
    for i in range(packed.radii.size):
        r, p = packed.radii[i], row[i + 1]
        held = min(w + r, p)
        moves[i + 1] = 1.0 if w - r >= held or w + r <= p else 0.0
        row[i + 1] = max(w - r, held)
    return w - last


@njit(**_OPTIONS)
def gate_of(packed: Any, move: Any) -> Any:
    """Share m of the step that is taken."""
    rate = packed.front[2]
    return np.float32(1.0 - math.exp(rate * abs(move))) if rate < 0.0 else _ONE


@njit(**_OPTIONS)
def approach(row: Any, share: Any, goal: Any) -> None:
    """row += share (goal - row)."""
    for j in range(row.size):
        row[j] += share * (goal[j] - row[j])


@njit(cache=True, error_model="numpy", nogil=True)
def rollout(packed: Any, rows: Any, cells: Any, plans: Any, angles: Any) -> None:
    """Scaled angles (N, K) of the scaled plans (N, K); rows (N, I + H) and cells (N, H) are moved on in place."""
    inputs, hidden = packed.radii.size + 1, packed.bias.size // 4
    most = min(plans.shape[0], _CHUNK)
    z = np.empty((most, 4 * hidden), np.float32)
    shares, moves = np.empty(most, np.float32), np.empty(inputs, np.float32)
    h, c = np.empty(hidden, np.float32), np.empty(hidden, np.float32)
    for start in range(0, plans.shape[0], most):
        count = min(most, plans.shape[0] - start)
        part = rows[start : start + count]
        for k in range(plans.shape[1]):
            for n in range(count):
                shares[n] = gate_of(packed, follow_front(packed, part[n], plans[start + n, k], moves))
            np.dot(part, packed.weights, z[:count])
            for n in range(count):
                c[:] = cells[start + n]
                cell_row(z[n], packed.bias, c, h)
                approach(cells[start + n], shares[n], c)
                approach(part[n, inputs:], shares[n], h)
                angles[start + n, k] = dot_row(packed.head, part[n]) + packed.head_bias[0]


@njit(**_OPTIONS)
def derivative_of_front(row: Any, moves: Any, lag: Any, own: bool) -> None:
    """Derivatives of the front (I,) by one command in place; `own` for the command of this sample.

    lag: share of w that stays, times whether the lag is still on its way.
    """
    row[0] = lag * row[0]
    if own:
        row[0] = moves[0]
    for i in range(1, moves.size):
        if moves[i] > 0.0:
            row[i] = row[0]


@njit(**_OPTIONS)
def derivative_of_cell(row: Any, cell: Any, z: Any, factors: Any, share: Any, by_share: Any) -> None:
    """Derivatives of h and c (H,) in place, from those of the gate arguments z (4H,).

    factors (8, H): the six of `differentiated_cell_row`, then a - h and b - c; by_share: derivative of the share.
    """
    n = cell.size
    for j in range(n):
        dc = factors[0, j] * cell[j] + factors[1, j] * z[j] + factors[2, j] * z[n + j] + factors[3, j] * z[2 * n + j]
        dh = factors[4, j] * z[3 * n + j] + factors[5, j] * dc
        row[j] += share * (dh - row[j]) + by_share * factors[6, j]
        cell[j] += share * (dc - cell[j]) + by_share * factors[7, j]


@njit(cache=True, error_model="numpy", nogil=True)
def linearise(packed: Any, row: Any, cell: Any, plan: Any, angles: Any, jacobian: Any) -> None:
    """Scaled angles (K,) along the scaled plan (K,) and their derivative (K, K), whose upper part is left alone.

    Row 0 of the table is the motion, row j the derivative by command j - 1, which joins at its own sample.
    """
    count, inputs, hidden = plan.size, packed.radii.size + 1, packed.bias.size // 4
    rows = np.zeros((count + 1, inputs + hidden), np.float32)
    cells = np.zeros((count + 1, hidden), np.float32)
    rows[0], cells[0] = row, cell
    z = np.empty((count + 1, 4 * hidden), np.float32)
    factors, moves = np.empty((8, hidden), np.float32), np.empty(inputs, np.float32)
    before = np.empty(count + 1, np.float32)
    h, c = np.empty(hidden, np.float32), np.empty(hidden, np.float32)
    for k in range(count):
        move = follow_front(packed, rows[0], plan[k], moves)
        share = gate_of(packed, move)
        lag = _ONE - moves[0]
        for r in range(1, k + 2):
            before[r] = rows[r, 0]
            derivative_of_front(rows[r, :inputs], moves, lag, r == k + 1)
        np.dot(rows[: k + 2], packed.weights, z[: k + 2])
        c[:] = cells[0]
        differentiated_cell_row(z[0], packed.bias, c, h, factors[:6])
        for j in range(hidden):
            factors[6, j], factors[7, j] = h[j] - rows[0, inputs + j], c[j] - cells[0, j]
        slope = packed.front[2] * (share - _ONE) * np.sign(move)
        for r in range(1, k + 2):
            by_share = slope * (rows[r, 0] - before[r])
            derivative_of_cell(rows[r, inputs:], cells[r], z[r], factors, share, by_share)
            jacobian[k, r - 1] = dot_row(packed.head, rows[r])
        approach(rows[0, inputs:], share, h)
        approach(cells[0], share, c)
        angles[k] = dot_row(packed.head, rows[0]) + packed.head_bias[0]


@njit(cache=True, error_model="numpy", nogil=True)
def sample(packed: Any, states: Any, rows: int, v: Any, theta: Any) -> None:
    """One sample of the first `rows` states (2, S) under commands v (2,), in place; theta (2,) takes the angles."""
    scaling, hidden = packed.scaling, packed.bias.size // 4
    plan, y = np.empty((1, 1), np.float32), np.empty((1, 1), np.float32)
    for row in range(rows):
        table = states[row].astype(np.float32).reshape(1, -1)
        ends = table.shape[1] - hidden
        own, cells = table[:, :ends].copy(), table[:, ends:].copy()
        plan[0, 0] = (v[row] - scaling[0]) / scaling[1]
        rollout(packed, own, cells, plan, y)
        states[row, :ends], states[row, ends:] = own[0], cells[0]
        theta[row] = scaling[2] + scaling[3] * y[0, 0]


@final
class GatedLstmRoute(NetworkRoute):
    """Matrix products of the library, on as many threads as the process gives BLAS.

    Args:
        arrays: initializers of the exported model, see `GatedLstmNet.write`.

    Raises:
        ModelError: if some are missing.
    """

    name = "plain"

    def __init__(self, arrays: Mapping[str, ArrayLike]) -> None:
        self.packed, self.sample = pack_gated_lstm(arrays), sample
        self._u_offset, self._u_scale, self._offset, self._scale = self.packed.scaling.tolist()
        self._ends = self.packed.head.size

    def advance(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        own, cells = self._parts(state, 1)
        y = np.empty((1, plan.size), np.float32)
        rollout(self.packed, own, cells, self._scaled(plan)[None], y)
        return self._angles(y[0]), np.concatenate([own[0], cells[0]]).astype(np.float64)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        own, cells = self._parts(state, len(plans))
        y = np.empty(plans.shape, np.float32)
        rollout(self.packed, own, cells, self._scaled(plans), y)
        return self._angles(y)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        own, cells = self._parts(state, 1)
        y, by_plan = np.empty(plan.size, np.float32), np.zeros((plan.size, plan.size), np.float32)
        linearise(self.packed, own[0], cells[0], self._scaled(plan), y, by_plan)
        return self._angles(y), self._scale / self._u_scale * by_plan.astype(np.float64)

    def _parts(self, state: Vec, count: int) -> tuple[Float32, Float32]:
        """Rows (N, I + H) and cells (N, H), float32 copies for a kernel to work on."""
        single = np.array(state, dtype=np.float32)
        return np.tile(single[: self._ends], (count, 1)), np.tile(single[self._ends :], (count, 1))

    def _scaled(self, u: Vec) -> Float32:
        return np.ascontiguousarray((u - self._u_offset) / self._u_scale, dtype=np.float32)

    def _angles(self, y: Float32) -> Vec:
        return self._offset + self._scale * y.astype(np.float64)

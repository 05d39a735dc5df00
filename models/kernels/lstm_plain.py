"""The plain route of a stacked LSTM in float32: on any processor, and what the vector kernel is tested against.

Matrix products through BLAS (`np.dot`), everything between them in loops that LLVM vectorises; roll-outs by
onnxruntime. All four gates are hyperbolic tangents, sigmoid(z) = 1/2 + 1/2 tanh(z/2), with the inner half already in
the weights. `error_model="numpy"` is what lets the division vectorise: Python's model would test every divisor for
zero. Callers check for not-a-number: the clamp of the gates would hide it.
"""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np
import onnx
import onnxruntime as ort
from numpy.typing import ArrayLike, NDArray

from hystmpc.trials.types import Vec

from ..contract.load import IR_VERSION, OPSET
from ..networks.lstm import LstmWeights, lstm_rollout_graph
from .network_route import Float32, NetworkRoute
from .numba_ import njit

_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "arcp", "reassoc"}}
_HALF, _ONE = np.float32(0.5), np.float32(1.0)

# Odd polynomial of degree 13 over even one of degree 6, as in Eigen and XLA: 3e-7 on the whole line.
_LIMIT = np.float32(7.90531110763549805)
_A1, _A3, _A5 = np.float32(4.89352455891786e-03), np.float32(6.37261928875436e-04), np.float32(1.48572235717979e-05)
_A7, _A9 = np.float32(5.12229709037114e-08), np.float32(-8.60467152213735e-11)
_A11, _A13 = np.float32(2.00018790482477e-13), np.float32(-2.76076847742355e-16)
_B0, _B2 = np.float32(4.89352518554385e-03), np.float32(2.26843463243900e-03)
_B4, _B6 = np.float32(1.18534705686654e-04), np.float32(1.19825839466702e-06)


@njit(**_OPTIONS)
def rational_tanh(x: Any) -> Any:
    """tanh(x) to 3e-7 without a branch; not-a-number is clamped away."""
    x = min(max(x, -_LIMIT), _LIMIT)
    s = x * x
    odd = _A1 + s * (_A3 + s * (_A5 + s * (_A7 + s * (_A9 + s * (_A11 + s * _A13)))))
    even = _B0 + s * (_B2 + s * (_B4 + s * _B6))
    return x * odd / even


@njit(**_OPTIONS)
def cell_row(z: Any, bias: Any, c: Any, h: Any) -> None:
    """c' = f c + i g and h' = o tanh(c') of one row (H,) from gate arguments z (4H,), which are used up."""
    n = c.size
    for j in range(4 * n):
        z[j] = rational_tanh(z[j] + bias[j])
    for j in range(n):
        forget, gain = _HALF + _HALF * z[n + j], _HALF + _HALF * z[j]
        c[j] = forget * c[j] + gain * z[2 * n + j]
    for j in range(n):
        h[j] = (_HALF + _HALF * z[3 * n + j]) * rational_tanh(c[j])


@njit(**_OPTIONS)
def differentiated_cell_row(z: Any, bias: Any, c: Any, h: Any, factors: Any) -> None:
    """As `cell_row`, and what `derivative_row` multiplies with, (6, H): by dc, dz_i, dz_f, dz_g; dz_o, dc'."""
    n = c.size
    for j in range(4 * n):
        z[j] = rational_tanh(z[j] + bias[j])
    for j in range(n):
        i, f, g, o = z[j], z[n + j], z[2 * n + j], z[3 * n + j]
        gain, forget, out = _HALF + _HALF * i, _HALF + _HALF * f, _HALF + _HALF * o
        factors[0, j] = forget
        factors[1, j] = _HALF * (_ONE - i * i) * g
        factors[2, j] = _HALF * (_ONE - f * f) * c[j]
        factors[3, j] = gain * (_ONE - g * g)
        c[j] = forget * c[j] + gain * g
        shown = rational_tanh(c[j])
        factors[4, j] = _HALF * (_ONE - o * o) * shown
        factors[5, j] = out * (_ONE - shown * shown)
        h[j] = out * shown


@njit(**_OPTIONS)
def derivative_row(z: Any, factors: Any, c: Any, h: Any) -> None:
    """Derivatives dc', dh' of one row (H,) from those of the gate arguments z (4H,) and dc; in place."""
    n = c.size
    for j in range(n):
        c[j] = factors[0, j] * c[j] + factors[1, j] * z[j] + factors[2, j] * z[n + j] + factors[3, j] * z[2 * n + j]
    for j in range(n):
        h[j] = factors[4, j] * z[3 * n + j] + factors[5, j] * c[j]


@njit(**_OPTIONS)
def add_row(row: Any, other: Any) -> None:
    """row += other."""
    for j in range(row.size):
        row[j] += other[j]


@njit(**_OPTIONS)
def add_multiple(row: Any, factor: Any, other: Any) -> None:
    """row += factor other."""
    for j in range(row.size):
        row[j] += factor * other[j]


@njit(**_OPTIONS)
def dot_row(a: Any, b: Any) -> Any:
    """Sum of a_j b_j."""
    total = np.float32(0.0)
    for j in range(a.size):
        total += a[j] * b[j]
    return total


_BLOCK = 4  # rows that a BLAS kernel keeps in registers
_FEW = 10  # rows up to which one product a row is faster


class PackedLstm(NamedTuple):
    """Weights as the kernels read them: float32, contiguous, one column a gate, sigmoid gates halved.

    Attributes:
        entry: weights of the scaled command (4H,).
        inputs: input weights of the layers above the first (L - 1, H, 4H).
        recurrent: recurrent weights of all layers (L, H, 4H).
        bias: (L, 4H).
        head: (H,).
        head_bias: (1,).
        scaling: u_offset, u_scale, theta_offset, theta_scale; float64.
    """

    entry: Float32
    inputs: Float32
    recurrent: Float32
    bias: Float32
    head: Float32
    head_bias: Float32
    scaling: NDArray[np.float64]


def pack_lstm(weights: LstmWeights) -> PackedLstm:
    """Arrange weights for the kernels; sigmoid(z) = 1/2 + 1/2 tanh(z/2), the inner half is applied here."""
    hidden, layers = weights.hidden, weights.layers
    half = np.repeat([0.5, 0.5, 1.0, 0.5], hidden)
    s = weights.scaling
    return PackedLstm(
        entry=_single(layers[0].w_ih[:, 0] * half),
        inputs=_single(
            np.reshape([layer.w_ih.T * half for layer in layers[1:]], (len(layers) - 1, hidden, 4 * hidden))
        ),
        recurrent=_single(np.stack([layer.w_hh.T * half for layer in layers])),
        bias=_single(np.stack([layer.bias * half for layer in layers])),
        head=_single(weights.head_weight),
        head_bias=_single([weights.head_bias]),
        scaling=np.array([s.u_offset, s.u_scale, s.theta_offset, s.theta_scale]),
    )


def _single(values: ArrayLike) -> Float32:
    return np.array(values, dtype=np.float32, order="C")


@njit(cache=True, error_model="numpy")
def advance(packed: Any, state: Any, plan: Any, angles: Any) -> None:
    """Scaled angles (K,) along the scaled `plan` (K,); `state` (2L, H) is moved on in place."""
    z = np.empty(packed.entry.size, np.float32)
    below = np.empty_like(z)
    for k in range(plan.size):
        for layer in range(len(packed.recurrent)):
            h, c = state[2 * layer], state[2 * layer + 1]
            np.dot(h, packed.recurrent[layer], z)
            if layer:
                np.dot(state[2 * layer - 2], packed.inputs[layer - 1], below)
                add_row(z, below)
            else:
                add_multiple(z, plan[k], packed.entry)
            cell_row(z, packed.bias[layer], c, h)
        angles[k] = dot_row(packed.head, state[-2]) + packed.head_bias[0]


@njit(cache=True, error_model="numpy")
def sample(packed: Any, states: Any, rows: int, v: Any, theta: Any) -> None:
    """One sample of the first `rows` states (2, S) under commands v (2,), in place; theta (2,) takes the angles."""
    scaling, plan, y = packed.scaling, np.empty(1, np.float32), np.empty(1, np.float32)
    for row in range(rows):
        layers = states[row].astype(np.float32).reshape(2 * len(packed.recurrent), packed.head.size)
        plan[0] = (v[row] - scaling[0]) / scaling[1]
        advance(packed, layers, plan, y)
        states[row] = layers.ravel()
        theta[row] = scaling[2] + scaling[3] * y[0]


@njit(cache=True, error_model="numpy")
def linearise(packed: Any, state: Any, plan: Any, angles: Any, jacobian: Any) -> None:
    """Scaled angles (K,) along the scaled `plan` (K,) and their derivative (K, K), whose upper part is left alone.

    Layer by layer, so that the inputs of a layer at all samples are one matrix product. A command acts from its own
    sample on: sample k has rows 0..k+1, the motion and k + 1 derivatives, stored behind those of the samples before.
    """
    count, hidden = plan.size, packed.head.size
    total = count * (count + 3) // 2
    z = np.zeros((total, 4 * hidden), np.float32)
    h = np.zeros((total + _BLOCK, hidden), np.float32)
    first = 0
    for k in range(count):
        for j in range(4 * hidden):
            z[first, j] = plan[k] * packed.entry[j]
            z[first + k + 1, j] = packed.entry[j]
        first += k + 2
    for layer in range(len(packed.recurrent)):
        if layer:
            np.dot(h[:total], packed.inputs[layer - 1], z)
        _differentiate_layer(packed.recurrent[layer], packed.bias[layer], state[2 * layer : 2 * layer + 2], z, h)
    first = 0
    for k in range(count):
        angles[k] = dot_row(packed.head, h[first]) + packed.head_bias[0]
        for r in range(k + 1):
            jacobian[k, r] = dot_row(packed.head, h[first + 1 + r])
        first += k + 2


@njit(cache=True, error_model="numpy")
def _differentiate_layer(recurrent: Any, bias: Any, start: Any, z: Any, h: Any) -> None:
    """Outputs h of a layer and their derivatives at all samples, from the input part z of its gates; rows as above."""
    hidden = h.shape[1]
    factors = np.empty((6, hidden), np.float32)
    before = np.zeros((_BLOCK, hidden), np.float32)
    before[0] = start[0]
    first, count = 0, 0
    rows = len(z)
    c = np.zeros((rows, hidden), np.float32)
    c[0] = start[1]
    feedback = np.empty((rows + _BLOCK, 4 * hidden), np.float32)
    while first < rows:
        count += 1  # rows alive at the sample before
        _product(before, recurrent, feedback, count)
        add_row(z[first], feedback[0])
        differentiated_cell_row(z[first], bias, c[0], h[first], factors)
        for r in range(1, count):
            add_row(z[first + r], feedback[r])
        for r in range(1, count + 1):
            derivative_row(z[first + r], factors, c[r], h[first + r])
        before = h[first:]
        first += count + 1


@njit(cache=True, error_model="numpy")
def _product(rows: Any, weights: Any, out: Any, count: int) -> None:
    """out[:count] = rows[:count] weights; both have _BLOCK rows to spare.

    BLAS repacks the weights in every matrix product: a few rows are faster one by one, more in full register blocks.
    """
    if count <= _FEW:
        for r in range(count):
            np.dot(rows[r], weights, out[r])
    else:
        padded = -(-count // _BLOCK) * _BLOCK
        np.dot(rows[:padded], weights, out[:padded])


_CHUNK = 32  # plans at a time: their gates stay in the second-level cache
_ERRORS_ONLY = 3


@final
class RolloutSession:
    """Roll-outs of one network from one state; from four plans on several times faster than products through BLAS."""

    def __init__(self, weights: LstmWeights) -> None:
        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = _ERRORS_ONLY
        model = onnx.helper.make_model(
            lstm_rollout_graph(weights), opset_imports=[onnx.helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
        )
        content = model.SerializeToString()
        self._run = ort.InferenceSession(content, options, providers=["CPUExecutionProvider"]).run
        self(np.zeros(weights.state_size, np.float32), np.zeros((_CHUNK, 2), np.float32))  # the first run allocates

    def __call__(self, state: Float32, plans: Float32) -> Float32:
        """Angles (N, H) [deg] of plans (N, H) [command unit] from a state (S,)."""
        states = np.tile(state, (min(_CHUNK, len(plans)), 1))
        angles = np.empty_like(plans)
        for first in range(0, len(plans), _CHUNK):
            part = plans[first : first + _CHUNK]
            (theta,) = self._run(["theta"], {"u": part, "state": states[: len(part)]})
            angles[first : first + _CHUNK] = np.asarray(theta)
        return angles


@final
class PlainRoute(NetworkRoute):
    """Matrix products of the library, on as many threads as the process gives BLAS; roll-outs on one."""

    name = "plain"

    def __init__(self, weights: LstmWeights) -> None:
        self.packed, self._roll = pack_lstm(weights), RolloutSession(weights)
        self.sample = sample
        self._scaling = weights.scaling
        self._shape = (2 * len(weights.layers), weights.hidden)

    def advance(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        following, y = self._layers(state), np.empty(plan.size, np.float32)
        advance(self.packed, following, self._scaled(plan), y)
        return self._angles(y), following.ravel().astype(np.float64)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._roll(state.astype(np.float32), plans.astype(np.float32)).astype(np.float64)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        y, by_plan = np.empty(plan.size, np.float32), np.zeros((plan.size, plan.size), np.float32)
        linearise(self.packed, self._layers(state), self._scaled(plan), y, by_plan)
        gain = self._scaling.theta_scale / self._scaling.u_scale
        return self._angles(y), gain * by_plan.astype(np.float64)

    def _layers(self, state: Vec) -> Float32:
        """A float32 copy (2L, H) of the state for a kernel to work on."""
        return np.array(state, dtype=np.float32).reshape(self._shape)

    def _scaled(self, u: Vec) -> Float32:
        return np.ascontiguousarray((u - self._scaling.u_offset) / self._scaling.u_scale, dtype=np.float32)

    def _angles(self, y: Float32) -> Vec:
        return self._scaling.theta_offset + self._scaling.theta_scale * y.astype(np.float64)

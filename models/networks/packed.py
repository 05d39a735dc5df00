"""Weights of recurrent networks in the order in which the engine's `network.c` reads them."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hystmpc.core.structs import layout, struct
from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from .lstm import GATED_MARK, LstmLayer, LstmWeights
from .nodes import Scaling

Cell = Literal["lstm", "gru", "gated"]
_KINDS: dict[Cell, int] = {"lstm": 0, "gru": 1, "gated": 2}
_HALVES = {"lstm": (0.5, 0.5, 1.0, 0.5), "gru": (0.5, 0.5, 1.0, 1.0), "gated": (0.5, 0.5, 1.0, 0.5)}
_SCALING = ("u_offset", "u_scale", "theta_offset", "theta_scale")
_EIGHT = 8  # units are whole eights: the head sums so many at once
_LINE = 64  # bytes of a cache line


@dataclass(frozen=True, eq=False)
class NetworkWeights:
    """A recurrent network as four sums a unit, which its cell turns into outputs.

    Attributes:
        cell: `lstm` with the sums i, f, g, o; `gru` with r, z and both parts of n; `gated`, an LSTM behind plays.
        layers: from the command upwards, all of H units; the first has I inputs.
        head: of the last layer's outputs (H,).
        head_bias: scalar.
        scaling: of command and angle.
        input_head: of the first layer's inputs (I,).
        radii: of the plays (I - 1,), scaled.
        front: k, e, -1 / s of `GatedLstmNet` (3,); k = 0 without a lag, -1 / s = 0 without the gate.
    """

    cell: Cell
    layers: tuple[LstmLayer, ...]
    head: Vec
    head_bias: float
    scaling: Scaling
    input_head: Vec = field(default_factory=lambda: np.zeros(1))
    radii: Vec = field(default_factory=lambda: np.zeros(0))
    front: Vec = field(default_factory=lambda: np.zeros(3))

    @property
    def hidden(self) -> int:
        """Number H of units in each layer."""
        return self.layers[0].hidden

    def units(self, lanes: int) -> int:
        """Number U of units of a layer in panels of so many lanes, the last ones zero."""
        whole = max(lanes, _EIGHT)
        return -(-self.hidden // whole) * whole


def weights_of(kind: str, arrays: Mapping[str, ArrayLike]) -> NetworkWeights:
    """Weights from the initializers of an exported model of kind `lstm` or `gru`.

    Raises:
        ModelError: naming the arrays that are missing.
    """
    if kind == "gru":
        return _gru(arrays)
    return _gated(arrays) if GATED_MARK in arrays else lstm_weights(LstmWeights.from_arrays(arrays))


def lstm_weights(weights: LstmWeights) -> NetworkWeights:
    """Weights of a stacked LSTM."""
    return NetworkWeights("lstm", weights.layers, weights.head_weight, weights.head_bias, weights.scaling)


def _gru(arrays: Mapping[str, ArrayLike]) -> NetworkWeights:
    """r, z, n = [a_n without own weights, c_n without input weights], see `GruNet`."""
    count = max(1, sum(name.startswith("gru.") and name.endswith(".hh.weight") for name in arrays))
    sides = [[f"gru.{k}.{side}.{part}" for side in ("ih", "hh") for part in ("weight", "bias")] for k in range(count)]
    wanted = [*(name for names in sides for name in names), "head.weight", "head.bias"]
    numbers = _numbers("GRU", arrays, wanted)
    hidden, stack = numbers["gru.0.hh.weight"].shape[1], []
    for w_ih, b_ih, w_hh, b_hh in ([numbers[name] for name in names] for names in sides):
        cut = 2 * hidden
        recurrent = np.concatenate([w_hh[:cut], np.zeros((hidden, hidden)), w_hh[cut:]])
        below = np.concatenate([w_ih, np.zeros((hidden, w_ih.shape[1]))])
        stack.append(LstmLayer(below, recurrent, np.concatenate([b_ih[:cut] + b_hh[:cut], b_ih[cut:], b_hh[cut:]])))
    head, bias = np.ravel(numbers["head.weight"]), numbers["head.bias"].item()
    return NetworkWeights("gru", tuple(stack), head, bias, _scaling(numbers))


def _gated(arrays: Mapping[str, ArrayLike]) -> NetworkWeights:
    parts = ("lstm.0.w_ih", "lstm.0.w_hh", "lstm.0.bias", GATED_MARK, "gated.head.bias")
    numbers = _numbers("gated LSTM", arrays, parts)
    layer = LstmLayer(*(numbers[name] for name in parts[:3]))
    head = np.ravel(numbers[GATED_MARK])
    front = [np.asarray(arrays.get(f"gated.{name}", 0.0)).item() for name in ("keep", "settled", "rate")]
    return NetworkWeights(
        "gated",
        (layer,),
        head[: layer.hidden],
        numbers["gated.head.bias"].item(),
        _scaling(numbers),
        head[layer.hidden :],
        np.ravel(np.asarray(arrays.get("gated.radii", []), dtype=np.float64)),
        np.array(front),
    )


def _numbers(name: str, arrays: Mapping[str, ArrayLike], parts: list[str] | tuple[str, ...]) -> dict[str, Vec]:
    wanted = [*parts, *(f"scaling.{part}" for part in _SCALING)]
    missing = [part for part in wanted if part not in arrays]
    if missing:
        raise ModelError(f"{name}: no array {', '.join(missing)}, available: {', '.join(sorted(arrays))}")
    return {part: np.asarray(arrays[part], dtype=np.float64) for part in wanted}


def _scaling(numbers: Mapping[str, Vec]) -> Scaling:
    return Scaling(*(numbers[f"scaling.{part}"].item() for part in _SCALING))


def pack_panels(weights: NetworkWeights, lanes: int) -> NDArray[np.float32]:
    """Panels of all layers one behind the other, each (1 + inputs, 4, lanes): its bias, then one input's weights.

    sigmoid(z) = 1/2 + 1/2 tanh(z/2), and the inner half goes in here.
    """
    hidden, units, parts = weights.hidden, weights.units(lanes), []
    half = np.array(_HALVES[weights.cell])
    for k, layer in enumerate(weights.layers):
        below = units if k else layer.inputs
        table = np.zeros((1 + below + units, 4, units))
        for start, part in ((0, layer.bias[:, None]), (1, layer.w_ih), (1 + below, layer.w_hh)):
            table[start : start + part.shape[1], :, :hidden] = part.T.reshape(-1, 4, hidden) * half[:, None]
        parts.append(table.reshape(len(table), 4, units // lanes, lanes).transpose(2, 0, 1, 3).ravel())
    return np.concatenate(parts).astype(np.float32)


def network_numbers(weights: NetworkWeights, lanes: int) -> NDArray[np.float32]:
    """Numbers behind the head of `hystmpc_network`: panels, head of the outputs and of the inputs, radii."""
    head = np.zeros(weights.units(lanes))
    head[: weights.hidden] = weights.head
    rest = np.concatenate([head, weights.input_head, weights.radii]).astype(np.float32)
    return np.concatenate([pack_panels(weights, lanes), rest])


def network_facts(weights: NetworkWeights) -> Mapping[str, Any]:
    """Fields of `hystmpc_network` by name."""
    s, (keep, settled, rate) = weights.scaling, weights.front.tolist()
    sizes = {"layers": len(weights.layers), "hidden": weights.hidden, "inputs": weights.layers[0].inputs}
    return {
        "u_offset": s.u_offset,
        "u_scale": s.u_scale,
        "theta_offset": s.theta_offset,
        "theta_scale": s.theta_scale,
        "head_bias": weights.head_bias,
        "kind": _KINDS[weights.cell],
        **sizes,
        "keep": keep,
        "settled": settled,
        "rate": rate,
    }


def pack_network(weights: NetworkWeights, lanes: int) -> NDArray[np.uint8]:
    """The block of bytes that the engine reads, see `network.h`; it starts at a cache line.

    Args:
        weights: of any width.
        lanes: of the engine, `network_lanes`.
    """
    numbers, head = network_numbers(weights, lanes), struct("hystmpc_network", **network_facts(weights))
    size = ctypes.sizeof(layout("hystmpc_network"))
    memory = np.empty(size + numbers.nbytes + _LINE, np.uint8)
    packed = memory[-memory.ctypes.data % _LINE :][: size + numbers.nbytes]
    ctypes.memmove(packed.ctypes.data, head.address, size)
    packed[size:] = numbers.view(np.uint8)
    return packed

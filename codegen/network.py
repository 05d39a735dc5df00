"""Recurrent networks as C: sizes, weights and scaling."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.networks.lstm import GATED_MARK, LstmWeights
from hystmpc.trials.errors import ExportError

if TYPE_CHECKING:
    from hystmpc.models.contract.load import OnnxModel

LANES = 16
"""Units of a panel of the weights, as `network.c` has it."""
_A_LINE = 8


@dataclass(frozen=True, eq=False)
class NetworkC:
    """Sizes, weights and scaling of a recurrent network for C.

    Attributes:
        hidden, layers: units of a layer, and layers.
        units: of a layer, padded to whole panels.
        weights: float32, by layer, then by panel.
        head: float32 (units,).
    """

    kind: str
    hidden: int
    layers: int
    units: int
    state_size: int
    weights: NDArray[np.float32]
    head: NDArray[np.float32]
    numbers: dict[str, Any]

    def sizes(self, rows: int) -> dict[str, int]:
        """Array sizes for `rows` plans or derivatives computed at once."""
        return {
            "units": self.units,
            "gru": int(self.kind == "gru"),
            "hidden": self.hidden,
            "layers": self.layers,
            "network": self.state_size,
            "network_rows": rows,
            "network_width": 1 + self.layers * self.units,
            "network_cells": self.layers * self.units,
        }

    def source(self) -> str:
        """C source of the weights."""
        return "\n".join([*_array("weights", self.weights), *_array("head", self.head), ""])


def network_of(model: OnnxModel) -> NetworkC:
    """Return the network of a model file as data for C.

    Raises:
        ExportError: if there is no C of its kind.
    """
    kind, arrays = model.metadata.kind, model.initializers
    if kind not in ("lstm", "gru") or model.metadata.connections or GATED_MARK in arrays:
        more = " with a gated cell" if GATED_MARK in arrays else ""
        more = f" with operators {model.metadata.connections[0].way}" if model.metadata.connections else more
        raise ExportError(
            f"export-c: got a model of kind {kind}{more} in an .onnx file, "
            "supported are simulators (.yaml), lstm and gru"
        )
    # The kernels' compiler is loaded for a network alone.
    from hystmpc.models.kernels.gru import gru_weights
    from hystmpc.models.kernels.lstm_vector import pack_panels
    from hystmpc.models.kernels.vector_emitter import EVEN, LIMIT, ODD

    weights = gru_weights(arrays) if kind == "gru" else LstmWeights.from_arrays(arrays)
    packed, count = pack_panels(weights, LANES, kind), len(weights.layers)
    used = [(2 if layer == 0 else 1 + packed.head.size) + packed.head.size for layer in range(count)]
    rows = [panels[:, : 4 * LANES * height].ravel() for panels, height in zip(packed.weights, used, strict=True)]
    offset = dict(zip(("u_offset", "u_scale", "theta_offset", "theta_scale"), packed.scaling.tolist(), strict=True))
    return NetworkC(
        kind,
        weights.hidden,
        count,
        packed.head.size,
        model.state_size,
        np.concatenate(rows),
        packed.head,
        {
            **offset,
            "head_bias": packed.head_bias,
            "tanh_limit": np.float32(LIMIT),
            "tanh_odd": np.array(ODD, np.float32),
            "tanh_even": np.array(EVEN, np.float32),
        },
    )


def _array(name: str, values: NDArray[np.float32]) -> Iterator[str]:
    yield f"HYSTMPC_SHARED HYSTMPC_AT_A_LINE const float hystmpc_{name}[{values.size}] = {{"
    texts = [single_number(value) for value in values]
    for first in range(0, len(texts), _A_LINE):
        yield "    " + ", ".join(texts[first : first + _A_LINE]) + ","
    yield "};"


def single_number(value: Any) -> str:
    """Shortest C literal that identifies a float uniquely."""
    return f"{np.format_float_scientific(np.float32(value), unique=True, trim='0')}F"

"""Recurrent networks as C: sizes, weights and scaling."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.networks.lstm import GATED_MARK
from hystmpc.models.networks.packed import pack_panels, weights_of
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
    weights = weights_of(kind, arrays)
    units, scaling = weights.units(LANES), asdict(weights.scaling)
    head = np.zeros(units, np.float32)
    head[: weights.hidden] = weights.head
    numbers = {**scaling, "head_bias": weights.head_bias}
    panels = pack_panels(weights, LANES)
    return NetworkC(kind, weights.hidden, len(weights.layers), units, model.state_size, panels, head, numbers)


def _array(name: str, values: NDArray[np.float32]) -> Iterator[str]:
    yield f"HYSTMPC_SHARED HYSTMPC_AT_A_LINE const float hystmpc_{name}[{values.size}] = {{"
    texts = [single_number(value) for value in values]
    for first in range(0, len(texts), _A_LINE):
        yield "    " + ", ".join(texts[first : first + _A_LINE]) + ","
    yield "};"


def single_number(value: Any) -> str:
    """Shortest C literal that identifies a float uniquely."""
    return f"{np.format_float_scientific(np.float32(value), unique=True, trim='0')}F"

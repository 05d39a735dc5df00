"""The stacked LSTM: its weights and ONNX nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from .nodes import GraphWriter, Scaling

GATED_MARK = "gated.head.weight"
"""Initializer that only an increment-gated LSTM has, see `GatedLstmNet`."""


@dataclass(frozen=True)
class LstmLayer:
    """One layer of H cells with I inputs; gates in the row order i, f, g, o, as in PyTorch.

    Attributes:
        w_ih: input weights (4H, I).
        w_hh: recurrent weights (4H, H).
        bias: sum of the input and the recurrent bias (4H,).

    Raises:
        ModelError: if sizes do not fit each other or a number is not finite.
    """

    w_ih: Vec
    w_hh: Vec
    bias: Vec

    def __post_init__(self) -> None:
        for name in ("w_ih", "w_hh", "bias"):
            object.__setattr__(self, name, _frozen(getattr(self, name), name))
        rows = 4 * self.hidden
        if self.w_hh.ndim != 2 or self.w_ih.ndim != 2 or {len(self.w_ih), len(self.w_hh), self.bias.size} != {rows}:
            raise ModelError(
                f"LSTM layer: got w_ih {self.w_ih.shape}, w_hh {self.w_hh.shape}, bias {self.bias.shape}, "
                "expected (4H, I), (4H, H), (4H,)"
            )

    @property
    def inputs(self) -> int:
        """Number I of inputs."""
        return self.w_ih.shape[-1]

    @property
    def hidden(self) -> int:
        """Number H of cells."""
        return self.w_hh.shape[-1]


@dataclass(frozen=True)
class LstmWeights:
    """Stacked LSTM from one command to one angle (Wu et al., RA-L 2021 (S1), eq. (1); RA-L 2024, PMC11633443 (S2)).

    With v = (u - u_offset) / u_scale and x = v for the first layer, x = h' of the layer below for the others:

        [i, f, o] = sigmoid(W_ih x + W_hh h + bias),  g = tanh(W_ih x + W_hh h + bias)
        c' = f c + i g,  h' = o tanh(c'),  theta = theta_offset + theta_scale (head_weight . h' + head_bias)

    The state of a model with L layers is [h_1, c_1, h_2, c_2, ...], S = 2 L H entries.

    Attributes:
        layers: from the command upwards; all of the same width H.
        head_weight: (H,).

    Raises:
        ModelError: if sizes do not fit each other or a number is not finite.
    """

    layers: tuple[LstmLayer, ...]
    head_weight: Vec
    head_bias: float
    scaling: Scaling = field(default_factory=Scaling)

    def __post_init__(self) -> None:
        object.__setattr__(self, "head_weight", _frozen(self.head_weight, "head_weight"))
        object.__setattr__(self, "head_bias", float(self.head_bias))
        if not self.layers:
            raise ModelError("LSTM: got no layer, expected at least one")
        sizes = [(layer.inputs, layer.hidden) for layer in self.layers]
        wanted = [(1, self.hidden)] + [(self.hidden, self.hidden)] * (len(sizes) - 1)
        if sizes != wanted or self.head_weight.shape != (self.hidden,) or not np.isfinite(self.head_bias):
            raise ModelError(
                f"LSTM: got (inputs, hidden) per layer {sizes}, head {self.head_weight.shape} and bias "
                f"{self.head_bias}, expected {wanted}, ({self.hidden},) and a finite number"
            )

    @property
    def hidden(self) -> int:
        """Number H of cells in each layer."""
        return self.layers[0].hidden

    @property
    def state_size(self) -> int:
        """Number S = 2 L H of state entries."""
        return 2 * len(self.layers) * self.hidden

    @property
    def parameter_count(self) -> int:
        """Number of trained parameters with two bias vectors a layer, as in the papers: 50,497 for two layers of 64."""
        per_layer = sum(layer.w_ih.size + layer.w_hh.size + 2 * layer.bias.size for layer in self.layers)
        return per_layer + self.hidden + 1

    def to_arrays(self) -> dict[str, Vec]:
        """Flat names and arrays, `lstm.0.w_ih` ... `scaling.theta_scale`, for `from_arrays`."""
        named: dict[str, ArrayLike] = {}
        for k, layer in enumerate(self.layers):
            named |= {f"lstm.{k}.{part.name}": getattr(layer, part.name) for part in fields(layer)}
        named |= {"head.weight": self.head_weight, "head.bias": self.head_bias}
        named |= {f"scaling.{part.name}": getattr(self.scaling, part.name) for part in fields(self.scaling)}
        return {name: np.asarray(value, dtype=np.float64) for name, value in named.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """Weights from arrays with the names of `to_arrays`; others are ignored.

        Raises:
            ModelError: naming the arrays that are missing.
        """
        count = 1
        while f"lstm.{count}.w_ih" in arrays:
            count += 1
        parts = [f"lstm.{k}.{part.name}" for k in range(count) for part in fields(LstmLayer)]
        scaling = [f"scaling.{part.name}" for part in fields(Scaling)]
        missing = [name for name in (*parts, "head.weight", "head.bias", *scaling) if name not in arrays]
        if missing:
            raise ModelError(f"LSTM: no array {', '.join(missing)}, available: {', '.join(sorted(arrays))}")
        layers = [LstmLayer(*(np.asarray(arrays[n]) for n in parts[3 * k : 3 * k + 3])) for k in range(count)]
        numbers = [float(np.asarray(arrays[name]).item()) for name in ("head.bias", *scaling)]
        return cls(tuple(layers), np.ravel(arrays["head.weight"]), numbers[0], Scaling(*numbers[1:]))


def _frozen(values: ArrayLike, name: str) -> Vec:
    """Read-only float64 copy, since weights are shared by kernels and sessions."""
    array = np.array(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ModelError(f"LSTM {name}: {np.count_nonzero(~np.isfinite(array))} numbers are not finite")
    array.setflags(write=False)
    return array


def write_layers(writer: GraphWriter, layers: tuple[LstmLayer, ...], v: str, state: str) -> tuple[str, list[str]]:
    """Write the nodes of stacked LSTM layers over `v` [N,1]; return the last h' and the parts of the next state."""
    hidden, count = layers[0].hidden, len(layers)
    writer.split(state, [hidden] * (2 * count), [f"{name}_{k}" for k in range(count) for name in ("h", "c")])
    following, x = [], v
    for k, layer in enumerate(layers):
        following += write_layer(writer, k, layer, x)
        x = following[-2]
    return x, following


def write_layer(writer: GraphWriter, k: int, layer: LstmLayer, x: str) -> list[str]:
    """Write the nodes of layer k over its input `x` and its state `h_k`, `c_k`; return the names of the next two."""
    names = {part: writer.weight(f"lstm.{k}.{part}", getattr(layer, part)) for part in ("w_ih", "w_hh", "bias")}
    writer.node("Gemm", [x, names["w_ih"], names["bias"]], f"zx_{k}", transB=1)
    writer.node("Gemm", [f"h_{k}", names["w_hh"], f"zx_{k}"], f"z_{k}", transB=1)
    writer.split(f"z_{k}", [layer.hidden] * 4, [f"z{gate}_{k}" for gate in "ifgo"])
    for gate, kind in (("i", "Sigmoid"), ("f", "Sigmoid"), ("g", "Tanh"), ("o", "Sigmoid")):
        writer.node(kind, [f"z{gate}_{k}"], f"{gate}_{k}")
    writer.node("Mul", [f"f_{k}", f"c_{k}"], f"kept_{k}")
    writer.node("Mul", [f"i_{k}", f"g_{k}"], f"added_{k}")
    writer.node("Add", [f"kept_{k}", f"added_{k}"], f"c_{k}_next")
    writer.node("Tanh", [f"c_{k}_next"], f"shown_{k}")
    writer.node("Mul", [f"o_{k}", f"shown_{k}"], f"h_{k}_next")
    return [f"h_{k}_next", f"c_{k}_next"]

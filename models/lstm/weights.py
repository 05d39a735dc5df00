"""The numbers of a stacked LSTM with a linear head, free of any framework, and its step in float64."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Self

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import numpy_helper

from hystmpc.trials.errors import ModelError

from ..model import Array
from ..networks.scaling import Scaling


@dataclass(frozen=True)
class LstmLayer:
    """One layer of H cells with I inputs; gates stand below each other in the order i, f, g, o (that of PyTorch).

    Attributes:
        w_ih: input weights (4H, I).
        w_hh: recurrent weights (4H, H).
        bias: sum of the input and the recurrent bias (4H,).

    Raises:
        ModelError: if sizes do not fit each other or a number is not finite.
    """

    w_ih: Array
    w_hh: Array
    bias: Array

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
    """A stacked LSTM, one command in, one angle out (Wu et al., RA-L 2021 (S1), eq. (1); RA-L 2024, PMC11633443 (S2)).

    With v = (u - u_offset) / u_scale and x = v for the first layer, x = h' of the layer below for the others:

        [i, f, o] = sigmoid(W_ih x + W_hh h + bias),  g = tanh(W_ih x + W_hh h + bias)
        c' = f c + i g,  h' = o tanh(c'),  theta = theta_offset + theta_scale (head_weight . h' + head_bias)

    The state of a model with L layers is [h_1, c_1, h_2, c_2, ...], S = 2 L H entries.

    Attributes:
        layers: from the command upwards; all of the same width H.
        head_weight: (H,).
        head_bias: scalar.
        scaling: units in and out.

    Raises:
        ModelError: if sizes do not fit each other or a number is not finite.
    """

    layers: tuple[LstmLayer, ...]
    head_weight: Array
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
        """Trained numbers, counted as the papers do, with two bias vectors a layer: 50,497 for two layers of 64."""
        per_layer = sum(layer.w_ih.size + layer.w_hh.size + 2 * layer.bias.size for layer in self.layers)
        return per_layer + self.hidden + 1

    def to_arrays(self) -> dict[str, Array]:
        """Flat names and arrays, `lstm.0.w_ih` ... `scaling.theta_scale`; what `from_arrays` takes."""
        named: dict[str, ArrayLike] = {}
        for k, layer in enumerate(self.layers):
            named |= {f"lstm.{k}.{part.name}": getattr(layer, part.name) for part in fields(layer)}
        named |= {"head.weight": self.head_weight, "head.bias": self.head_bias}
        named |= {f"scaling.{part.name}": getattr(self.scaling, part.name) for part in fields(self.scaling)}
        return {name: np.asarray(value, dtype=np.float64) for name, value in named.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """Build from the names that `to_arrays` gives; others are left alone.

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

    @classmethod
    def from_graph(cls, graph: onnx.GraphProto) -> Self:
        """Read the weights back from the named initializers of a step graph that `lstm_step_graph` made.

        Raises:
            ModelError: if the graph is not one of these.
        """
        arrays = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
        return cls.from_arrays(arrays)


def _frozen(values: ArrayLike, name: str) -> Array:
    """A read-only float64 copy; weights shared by kernels and sessions must not change behind them."""
    array = np.array(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ModelError(f"LSTM {name}: {np.count_nonzero(~np.isfinite(array))} numbers are not finite")
    array.setflags(write=False)
    return array

"""Scaling of a network's input and output, and the ONNX nodes and float32 weights of its step graph."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import TensorProto, helper, numpy_helper

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..contract.onnx_nodes import tensor

FLOAT = TensorProto.FLOAT


@dataclass(frozen=True)
class Scaling:
    """Scaling of input and output: v = (u - u_offset) / u_scale, theta = theta_offset + theta_scale * y.

    For an inverse map `u` is the angle and `theta` the command.

    Attributes:
        u_offset, u_scale: in the unit of the input [mm or bar].
        theta_offset, theta_scale: in the unit of the output [deg].

    Raises:
        ModelError: if a number is not finite or a scale not positive.
    """

    u_offset: float = 0.0
    u_scale: float = 6.0
    theta_offset: float = 0.0
    theta_scale: float = 90.0

    def __post_init__(self) -> None:
        values = [getattr(self, f.name) for f in fields(self)]
        if not np.isfinite(values).all() or self.u_scale <= 0 or self.theta_scale <= 0:
            raise ModelError(f"network scaling: got {values}, expected finite numbers and scales > 0")

    def scale_in(self, u: Vec) -> Vec:
        """Scaled input v."""
        return (u - self.u_offset) / self.u_scale

    def scale_out(self, theta: Vec) -> Vec:
        """Scaled output y of an output `theta`."""
        return (theta - self.theta_offset) / self.theta_scale

    def to_units(self, y: Vec) -> Vec:
        """Output `theta` of a scaled output y."""
        return self.theta_offset + self.theta_scale * y


class GraphWriter:
    """Collector of the nodes and initializers of one graph."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self._tensors: dict[str, np.ndarray] = {}

    def node(self, kind: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        """Append a node with the output `output`, and return that name."""
        self.nodes.append(helper.make_node(kind, list(inputs), [output], name=f"make_{output}", **attributes))
        return output

    def weight(self, name: str, values: ArrayLike) -> str:
        """Add a float32 initializer and return its name."""
        self._tensors[name] = np.asarray(values, dtype=np.float32)
        return name

    def indices(self, name: str, values: Sequence[int]) -> str:
        """Add an initializer of integers (axes, sizes) and return its name."""
        self._tensors[name] = np.array(values, np.int64)
        return name

    def split(self, x: str, sizes: Sequence[int], outputs: Sequence[str]) -> list[str]:
        """Split the columns of `x` [N, sum(sizes)] into `outputs`; empty ones are left out."""
        kept = [(size, output) for size, output in zip(sizes, outputs, strict=True) if size]
        if len(kept) == 1:
            self.node("Identity", [x], kept[0][1])
        else:
            sizes_of = self.indices(f"{x}_sizes", [size for size, _ in kept])
            names = [output for _, output in kept]
            self.nodes.append(helper.make_node("Split", [x, sizes_of], names, name=f"split_{x}", axis=1))
        return list(outputs)

    def join(self, parts: Sequence[str], output: str) -> str:
        """Join the columns of `parts`."""
        return self.node("Concat", parts, output, axis=1) if len(parts) > 1 else self.node("Identity", parts, output)

    def affine(self, x: str, name: str, weight: ArrayLike, bias: ArrayLike, output: str) -> str:
        """Write x W' + b with the weight (outputs, inputs) of PyTorch; initializers `name.weight`, `name.bias`."""
        operands = [x, self.weight(f"{name}.weight", weight), self.weight(f"{name}.bias", bias)]
        return self.node("Gemm", operands, output, transB=1)

    def scale_in(self, scaling: Scaling, u: str, output: str) -> str:
        """Write the scaled input; all four numbers of the scaling become initializers `scaling.*`."""
        for part in fields(scaling):
            self.weight(f"scaling.{part.name}", getattr(scaling, part.name))
        self.node("Sub", [u, "scaling.u_offset"], "u_centred")
        return self.node("Div", ["u_centred", "scaling.u_scale"], output)

    def scale_out(self, y: str, output: str = "theta") -> str:
        """Write the output in its unit, after `scale_in`."""
        self.node("Mul", [y, "scaling.theta_scale"], "theta_centred")
        return self.node("Add", ["theta_centred", "scaling.theta_offset"], output)

    def initializers(self) -> list[onnx.TensorProto]:
        """All weights and sizes."""
        return [numpy_helper.from_array(array, name) for name, array in self._tensors.items()]


Body = Callable[[GraphWriter, str, str], tuple[str, Sequence[str]]]
"""Writes the nodes between scaled input and state, and scaled output and the parts of the next state."""


def network_step_graph(name: str, state_size: int, scaling: Scaling, body: Body) -> onnx.GraphProto:
    """Step graph (u [N,1], state [N,S]) -> (theta [N,1], next_state [N,S]) in float32, scalings inside."""
    writer = GraphWriter()
    y, following = body(writer, writer.scale_in(scaling, "u", "v"), "state")
    writer.join(following, "next_state")
    writer.scale_out(y)
    return helper.make_graph(
        writer.nodes,
        name,
        [tensor("u", 1, FLOAT), tensor("state", state_size, FLOAT)],
        [tensor("theta", 1, FLOAT), tensor("next_state", state_size, FLOAT)],
        writer.initializers(),
    )

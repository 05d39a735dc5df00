"""ONNX nodes from an instruction list: the step graph of an operator chain, or an operator within a network."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import TensorProto, helper, numpy_helper

from ..program import Instruction, instructions

_BINARY = {"add": "Add", "sub": "Sub", "mul": "Mul", "div": "Div", "and": "Mul", "pow": "Pow"}
_COMPARE = {"lt": "Less", "le": "LessOrEqual", "eq": "Equal"}
_FROM_ONE = {"not": "Sub", "inv": "Div"}
_UNARY = {
    "neg": "Neg",
    "fabs": "Abs",
    "sign": "Sign",
    "sqrt": "Sqrt",
    "exp": "Exp",
    "log": "Log",
    "tanh": "Tanh",
    "sin": "Sin",
    "floor": "Floor",
    "assign": "Identity",
}

INTERFACE = (("u", "state"), ("theta", "next_state"))
"""Inputs and outputs of a step graph."""


class _Writer:
    """Collector of the nodes and constants of one program; registers become columns (N, 1)."""

    def __init__(self, prefix: str = "", element: int = TensorProto.DOUBLE) -> None:
        self.prefix, self.element = prefix, element
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[float, str] = {}
        self.count = 0

    def node(self, kind: str, inputs: list[str], **attributes: Any) -> str:
        self.count += 1
        out = f"{self.prefix}{kind.lower()}_{self.count}"
        self.nodes.append(helper.make_node(kind, inputs, [out], name=out, **attributes))
        return out

    def constant(self, value: float) -> str:
        return self.constants.setdefault(value, f"{self.prefix}constant_{len(self.constants)}")

    def number(self, condition: str) -> str:
        """Convert a truth column into 1.0 or 0.0."""
        return self.node("Cast", [condition], to=self.element)

    def operation(self, step: Instruction, w: dict[int, str]) -> str:
        a = [w[i] for i in step.args]
        if step.name in _BINARY:
            return self.node(_BINARY[step.name], a)
        if step.name in _UNARY:
            return self.node(_UNARY[step.name], a)
        if step.name in _COMPARE:
            return self.number(self.node(_COMPARE[step.name], a))
        zero, one = self.constant(0.0), self.constant(1.0)
        if step.name == "if_else_zero":
            return self.node("Where", [self.node("Greater", [self.node("Abs", [a[0]]), zero]), a[1], zero])
        if step.name in ("fmin", "fmax"):
            compare = "LessOrEqual" if step.name == "fmin" else "GreaterOrEqual"
            return self.node("Where", [self.node(compare, a), *a])
        if step.name == "ne":
            return self.number(self.node("Not", [self.node("Equal", a)]))
        if step.name == "or":
            return self.number(self.node("Greater", [self.node("Add", a), zero]))
        if step.name in _FROM_ONE:
            return self.node(_FROM_ONE[step.name], [one, a[0]])
        if step.name == "cos":  # onnxruntime before 1.29 has Cos in single precision only
            return self.node("Sin", [self.node("Add", [a[0], self.constant(0.5 * math.pi)])])
        return self.node({"sq": "Mul", "twice": "Add"}[step.name], [a[0], a[0]])


@dataclass(frozen=True)
class OperatorNodes:
    """ONNX nodes of one program inside a larger graph.

    Attributes:
        constants: names and values of the numbers, to become initializers of shape (1, 1).
        outputs: name of the column (N, 1) of every element of every output.
    """

    nodes: list[onnx.NodeProto]
    constants: dict[str, float]
    outputs: list[list[str]]


def operator_nodes(
    function: Any, inputs: Sequence[Sequence[str]], prefix: str = "", element: int = TensorProto.DOUBLE
) -> OperatorNodes:
    """Translate a dense CasADi function of named columns (N, 1) into ONNX nodes.

    Args:
        function: any number of inputs and outputs.
        inputs: column of every element of every input.
        prefix: of all names made here.
        element: number type of the columns, a `TensorProto` type.
    """
    writer = _Writer(prefix, element)
    registers: dict[int, str] = {}
    outputs = [[""] * function.numel_out(j) for j in range(function.n_out())]
    for step in instructions(function):
        if step.name == "input":
            registers[step.out[0]] = inputs[step.args[0]][step.args[1]]
        elif step.name == "output":
            outputs[step.out[0]][step.out[1]] = registers[step.args[0]]
        elif step.name == "const":
            registers[step.out[0]] = writer.constant(step.value)
        else:
            registers[step.out[0]] = writer.operation(step, registers)
    return OperatorNodes(writer.nodes, {label: value for value, label in writer.constants.items()}, outputs)


def step_graph(function: Any, name: str) -> onnx.GraphProto:
    """Translate (state (S, 1), u (nu, 1)) -> (theta (ny, 1), next state) into a graph.

    Its inputs are u [N,nu] and state [N,S], its outputs theta [N,ny] and next_state [N,S].
    """
    sizes = {"u": function.numel_in(1), "state": function.numel_in(0)}
    splits, (commands, columns) = [], ([f"{key}_{i}" for i in range(size)] for key, size in sizes.items())
    for key, parts in (("state", columns), ("u", commands)):
        if len(parts) > 1:
            splits.append(helper.make_node("Split", [key], parts, name=f"split_{key}", axis=1, num_outputs=len(parts)))
        elif key == "state":
            splits.append(helper.make_node("Identity", [key], parts, name=f"split_{key}"))
    commands = commands if len(commands) > 1 else ["u"]
    program = operator_nodes(function, [columns, commands])
    theta, following = program.outputs
    shown, spread = as_columns([*theta, *following], program.constants, by=commands[0])
    last = [
        *spread,
        _joined(shown[: len(theta)], "theta"),
        helper.make_node("Concat", shown[len(theta) :], ["next_state"], name="next_state", axis=1),
    ]
    return helper.make_graph(
        [*splits, *program.nodes, *last],
        name,
        [tensor(key, size) for key, size in sizes.items()],
        [tensor("theta", len(theta)), tensor("next_state", len(following))],
        initializer=[
            numpy_helper.from_array(np.full((1, 1), value), name=label) for label, value in program.constants.items()
        ],
    )


def _joined(columns: list[str], name: str) -> onnx.NodeProto:
    """Tensor (N, n) of n columns."""
    if len(columns) == 1:
        return helper.make_node("Identity", columns, [name], name=name)
    return helper.make_node("Concat", columns, [name], name=name, axis=1)


def node(kind: str, inputs: str, outputs: str, **attributes: Any) -> onnx.NodeProto:
    """ONNX node whose inputs and outputs are given as names separated by blanks."""
    return helper.make_node(kind, inputs.split(), outputs.split(), name=outputs.split()[0], **attributes)


def graph_of_nodes(
    name: str,
    state_size: int,
    nodes: Sequence[onnx.NodeProto],
    numbers: Mapping[str, ArrayLike],
    indices: Mapping[str, Sequence[int]],
) -> onnx.GraphProto:
    """Step graph in double from nodes between `u`, `state`, `theta` and `next_state`.

    Args:
        indices: axes, sizes and places by name.
    """
    weights = [numpy_helper.from_array(np.array(value, np.float64), key) for key, value in numbers.items()]
    weights += [numpy_helper.from_array(np.array(value, np.int64), key) for key, value in indices.items()]
    inputs, outputs = ([tensor(one, 1), tensor(state, state_size)] for one, state in INTERFACE)
    return helper.make_graph(nodes, name, inputs, outputs, initializer=weights)


def as_columns(
    names: list[str], constants: Mapping[str, float], prefix: str = "", by: str = "u"
) -> tuple[list[str], list[onnx.NodeProto]]:
    """Names with each constant (1, 1) expanded to a column (N, 1) as `by` is, and the nodes that expand them."""
    nodes, spread = [], {name: f"{name}_column" for name in names if name in constants}
    each = f"{prefix}each_row"
    if spread:
        nodes.append(helper.make_node("LessOrEqual", [by, by], [each], name=each))
    for name, column in spread.items():
        nodes.append(helper.make_node("Where", [each, name, name], [column], name=column))
    return [spread.get(name, name) for name in names], nodes


def tensor(name: str, width: int | str, element: int = TensorProto.DOUBLE) -> onnx.ValueInfoProto:
    """Input or output (N, width) of a graph."""
    return helper.make_tensor_value_info(name, element, ["N", width])

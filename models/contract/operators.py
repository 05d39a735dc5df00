"""The closed list of ONNX operators that a model may consist of, and the check that it does."""

from __future__ import annotations

import onnx

from hystmpc.trials.errors import ModelError

_ARITHMETIC = ("Add", "Sub", "Mul", "Div", "Neg", "Reciprocal", "Abs", "Sign", "Floor", "Ceil", "Cast", "Identity")
_FUNCTIONS = ("Sqrt", "Exp", "Log", "Pow", "Sin", "Cos", "Tanh", "Sigmoid", "Softplus", "Erf", "Relu")
_BRANCHES = (
    "Max",
    "Min",
    "Clip",
    "Where",
    "Less",
    "LessOrEqual",
    "Greater",
    "GreaterOrEqual",
    "Equal",
    "And",
    "Or",
    "Not",
)
_REARRANGING = ("Concat", "Expand", "Gather", "Reshape", "Slice", "Split", "Squeeze", "Transpose", "Unsqueeze")
_SUMMING = ("Gemm", "MatMul", "ReduceSum")
_SOURCES = ("Constant", "Shape")
ALLOWED = frozenset((*_ARITHMETIC, *_FUNCTIONS, *_BRANCHES, *_REARRANGING, *_SUMMING, *_SOURCES))


def check_operators(graph: onnx.GraphProto, where: str) -> None:
    """Hold every node against the list.

    Raises:
        ModelError: naming the first node that is not on it, its operator, and the list.
    """
    for index, node in enumerate(graph.node):
        domain = "" if node.domain == "ai.onnx" else node.domain
        if domain or node.op_type not in ALLOWED:
            operator = f"{domain}.{node.op_type}" if domain else node.op_type
            raise ModelError(
                f"{where}: node {node_name(node, index)} uses operator {operator!r}, which is not on the list, "
                f"available: {', '.join(sorted(ALLOWED))}"
            )


def node_name(node: onnx.NodeProto, index: int) -> str:
    """How messages call a node: its name, else its place and first output."""
    return repr(node.name) if node.name else f"{index} (output {node.output[0] if node.output else 'none'!r})"

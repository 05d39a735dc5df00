"""What a model file must be before it is opened: a whole ONNX model of the contract's layout with finite weights."""

from __future__ import annotations

import numpy as np
import onnx
import onnx.checker
import onnx.numpy_helper
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]  # its types are a package of their own

from hystmpc.trials.errors import ModelError

OPSET = 18
IR_VERSION = 8  # the oldest that has opset 18; onnxruntime 1.20 reads up to 10
_TYPES: dict[int, np.dtype[np.generic]] = {
    onnx.TensorProto.FLOAT: np.dtype(np.float32),
    onnx.TensorProto.DOUBLE: np.dtype(np.float64),
}
_MAGIC = {b"\x80": "a pickle, which is never loaded", b"PK": "a zip archive, which is never unpacked"}


def parse_model(content: bytes, where: str) -> onnx.ModelProto:
    """Decode the bytes of an ONNX file.

    Raises:
        ModelError: if they are something else or cut off.
    """
    for magic, kind in _MAGIC.items():
        if content.startswith(magic):
            raise ModelError(f"{where}: is {kind}, expected an ONNX file written by export_onnx")
    try:
        proto = onnx.load_model_from_string(content)
    except DecodeError:
        proto = onnx.ModelProto()
    if not proto.graph.node:
        raise ModelError(
            f"{where}: {len(content)} bytes are not a whole ONNX model (damaged, cut off, or another kind of file), "
            "expected a file written by export_onnx"
        )
    return proto


def check_graph(proto: onnx.ModelProto, state_size: int, where: str) -> np.dtype[np.generic]:
    """Hold operators, inputs, outputs and weights against the contract; returns the number type.

    Raises:
        ModelError: one line on the first thing that differs.
    """
    opsets = {item.domain: item.version for item in proto.opset_import}
    if opsets != {"": OPSET} or proto.functions:
        raise ModelError(
            f"{where}: operator sets {opsets} and {len(proto.functions)} functions, expected {{'': {OPSET}}} and none"
        )
    check_operators(proto.graph, where)
    dtype = _check_interface(proto.graph, state_size, where)
    _check_weights(proto.graph, where)
    try:
        onnx.checker.check_model(proto, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError, UnicodeDecodeError) as error:
        raise ModelError(f"{where}: not a valid ONNX graph: {' '.join(str(error).split())}") from None
    return dtype


def _check_interface(graph: onnx.GraphProto, state_size: int, where: str) -> np.dtype[np.generic]:
    """Names, shapes and one number type of the four tensors."""
    weights = {weight.name for weight in graph.initializer}
    inputs = [value for value in graph.input if value.name not in weights]
    first = inputs[0].type.tensor_type.elem_type if inputs else onnx.TensorProto.FLOAT
    dtype = _TYPES.get(first, np.dtype(np.float32))
    sizes = {"u": 1, "state": state_size}, {"theta": 1, "next_state": state_size}
    for kind, values, expected in zip(("inputs", "outputs"), (inputs, graph.output), sizes, strict=True):
        got = sorted(_signature(value) for value in values)
        wanted = sorted(f"{name!r} {dtype.name} [N,{size}]" for name, size in expected.items())
        if got != wanted:
            raise ModelError(f"{where}: {kind} are {', '.join(got) or 'none'}, expected {', '.join(wanted)}")
    return dtype


def _signature(value: onnx.ValueInfoProto) -> str:
    """`'name' dtype [N,size]`; N stands for any axis of free length."""
    tensor = value.type.tensor_type
    shape = ",".join(str(d.dim_value) if d.HasField("dim_value") else "N" for d in tensor.shape.dim)
    dtype = _TYPES[tensor.elem_type].name if tensor.elem_type in _TYPES else f"type {tensor.elem_type}"
    return f"{value.name!r} {dtype} [{shape}]"


def _check_weights(graph: onnx.GraphProto, where: str) -> None:
    if graph.sparse_initializer:
        raise ModelError(f"{where}: has sparse initializers, expected dense ones")
    named = [(f"initializer {weight.name!r}", weight) for weight in graph.initializer]
    for index, node in enumerate(graph.node):
        named += [(f"node {node_name(node, index)}", item.t) for item in node.attribute if item.HasField("t")]
        if any(item.HasField("sparse_tensor") or item.tensors or item.sparse_tensors for item in node.attribute):
            raise ModelError(f"{where}: node {node_name(node, index)} has sparse or several tensors, expected one")
    for name, weight in named:
        if weight.external_data or weight.data_location == onnx.TensorProto.EXTERNAL:
            raise ModelError(f"{where}: {name} lies outside the file, expected all weights inside")
        try:
            values = onnx.numpy_helper.to_array(weight)
        except (ValueError, TypeError, KeyError) as error:
            raise ModelError(f"{where}: {name} cannot be read ({error})") from None
        bad = np.flatnonzero(~np.isfinite(values)) if values.dtype.kind == "f" else np.empty(0)
        if bad.size:
            raise ModelError(f"{where}: {name} is {values.flat[bad[0]]} at entry {bad[0]}, expected finite weights")


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

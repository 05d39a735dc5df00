"""Loader of model files for onnxruntime: a file is checked completely, and nothing in it is executed as code."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, final, get_args

import numpy as np
import onnx
import onnx.checker
import onnx.numpy_helper
import onnxruntime as ort
import onnxruntime.capi.onnxruntime_pybind11_state as state_
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]  # its types are in a separate package
from numpy.typing import NDArray

from hystmpc.trials.errors import ModelError
from hystmpc.trials.trial import MOST_COMMANDS, MOST_INPUTS
from hystmpc.trials.types import Vec

from ..model import LoadedModel
from .casadi_ import check_operators, node_name, to_casadi
from .metadata import ModelMetadata, Start

if TYPE_CHECKING:
    import casadi as ca


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
        ModelError: if they are not an ONNX file, or are cut off.
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


@dataclass(frozen=True)
class GraphSizes:
    """Number type and sizes of a step graph: u [N, inputs], state [N, states], theta [N, outputs].

    Attributes:
        inputs: commands, and behind them inputs that are measured.
    """

    dtype: np.dtype[np.generic]
    states: int
    inputs: int = 1
    outputs: int = 1


def check_graph(proto: onnx.ModelProto, state_size: int, where: str) -> GraphSizes:
    """Check operators, inputs, outputs and weights against the contract, and return number type and sizes.

    Raises:
        ModelError: one line on the first difference.
    """
    opsets = {item.domain: item.version for item in proto.opset_import}
    if opsets != {"": OPSET} or proto.functions:
        raise ModelError(
            f"{where}: operator sets {opsets} and {len(proto.functions)} functions, expected {{'': {OPSET}}} and none"
        )
    check_operators(proto.graph, where)
    sizes = _check_interface(proto.graph, state_size, where)
    _check_weights(proto.graph, where)
    try:
        onnx.checker.check_model(proto, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError, UnicodeDecodeError) as error:
        raise ModelError(f"{where}: not a valid ONNX graph: {' '.join(str(error).split())}") from None
    return sizes


def _check_interface(graph: onnx.GraphProto, state_size: int, where: str) -> GraphSizes:
    """Check names and shapes of the four tensors, and return their common number type and sizes."""
    weights = {weight.name for weight in graph.initializer}
    inputs = [value for value in graph.input if value.name not in weights]
    first = inputs[0].type.tensor_type.elem_type if inputs else onnx.TensorProto.FLOAT
    dtype = _TYPES.get(first, np.dtype(np.float32))
    widths = _width(inputs, "u", MOST_COMMANDS + MOST_INPUTS), _width(graph.output, "theta", MOST_COMMANDS)
    sizes = GraphSizes(dtype, state_size, *widths)
    tensors = {"u": sizes.inputs, "state": state_size}, {"theta": sizes.outputs, "next_state": state_size}
    for kind, values, expected in zip(("inputs", "outputs"), (inputs, graph.output), tensors, strict=True):
        got = sorted(_signature(value) for value in values)
        wanted = sorted(f"{name!r} {dtype.name} [N,{size}]" for name, size in expected.items())
        if got != wanted:
            raise ModelError(f"{where}: {kind} are {', '.join(got) or 'none'}, expected {', '.join(wanted)}")
    return sizes


def _width(values: Iterable[onnx.ValueInfoProto], name: str, most: int) -> int:
    """Second size of the tensor of a name, where it is one to `most`; else one, which the check then expects."""
    shapes = [value.type.tensor_type.shape.dim for value in values if value.name == name]
    width = shapes[0][1].dim_value if len(shapes) == 1 and len(shapes[0]) == 2 else 1
    return width if 1 <= width <= most else 1


def _signature(value: onnx.ValueInfoProto) -> str:
    """Description `'name' dtype [N,size]`; N is any axis of free length."""
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


@final
class OnnxModel(LoadedModel):
    """Step graph in onnxruntime on one thread; inputs are converted to its number type, outputs to float64.

    Attributes:
        initializers: the graph's weights by name.
        dtype: number type of the graph, float32 or float64.
        source: the file's path, for messages and reports.
        start: which of the two initial rules `initial` follows.
    """

    def __init__(self, content: bytes, source: str = "<memory>", start: Start = "initial") -> None:
        """Check the bytes of a model file and open it.

        Raises:
            ModelError: as `load_onnx`, or if `start` is unknown.
        """
        if start not in get_args(Start):
            raise ModelError(f"{source}: start is {start!r}, available: conditioned, initial")
        proto = parse_model(content, source)
        # Protobuf returns damaged text as bytes; as str it is neither a known key nor JSON.
        properties = {str(entry.key): str(entry.value) for entry in proto.metadata_props}
        super().__init__(ModelMetadata.from_properties(properties, source), start)
        sizes = check_graph(proto, self.state_size, source)
        if (sizes.inputs, sizes.outputs) != (1, 1):
            raise ModelError(
                f"{source}: has {sizes.inputs} inputs and {sizes.outputs} outputs, expected one command and one angle; "
                "models of several axes are not opened by this version of hystmpc"
            )
        self.dtype = sizes.dtype
        self.graph: onnx.GraphProto = proto.graph
        self.initializers: Mapping[str, NDArray[np.generic]] = {
            weight.name: onnx.numpy_helper.to_array(weight) for weight in proto.graph.initializer
        }
        self.hash: str = hashlib.sha256(content).hexdigest()
        self.source = source
        self.start: Start = start
        self._run = open_session(content, sizes, source).run

    @property
    def simulator(self) -> NoReturn:
        """Refuse a readable form, which only chains of operators have.

        Raises:
            ModelError: always.
        """
        raise ModelError(f"{self.source}: an exported model has no readable form, expected a simulator file (.yaml)")

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        """Angles (N, 1) [deg] and next states (N, S) from states (N, S) and commands (N, 1).

        Raises:
            ModelError: if the shapes are wrong.
        """
        if state.shape != (u.shape[0], self.state_size) or u.shape != (u.shape[0], 1):
            raise ModelError(
                f"{self.source}: got states {state.shape} and commands {u.shape}, "
                f"expected (N, {self.state_size}) and (N, 1)"
            )
        feed = {"u": u.astype(self.dtype), "state": state.astype(self.dtype)}
        theta, following = self._run(["theta", "next_state"], feed)
        return np.array(theta, dtype=np.float64), np.array(following, dtype=np.float64)

    def casadi_function(self) -> ca.Function:
        """Step as `casadi.Function`: state (S, 1), u (1, 1) -> theta (1, 1), next_state (S, 1).

        Raises:
            ModelError: if a node cannot be translated; names the node.
        """
        return to_casadi(self.graph, "model")


def load_onnx(path: Path | str, start: Start = "initial") -> OnnxModel:
    """Read a model file written by `export_onnx`.

    Args:
        start: "initial" for recorded trials of a device that was not flexed since it was set up, "conditioned" for a
            device after its initialisation flexure, as controllers need it.

    Raises:
        ModelError: if the file is missing, not ONNX or cut off, foreign (without the metadata), of another format
            version, has an operator outside the list, other inputs or outputs than the contract, or weights that are
            not finite or lie outside the file.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror}), expected an ONNX file") from None
    return OnnxModel(content, str(path), start)


_ERRORS = (
    state_.EPFail,
    state_.Fail,
    state_.InvalidArgument,
    state_.InvalidGraph,
    state_.InvalidProtobuf,
    state_.NotImplemented,
    state_.RuntimeException,
)
_SILENT = 3  # errors only
_WARM_UP = (1, 2, 1)  # batch sizes; the second differs so that a frozen batch axis shows


def open_session(content: bytes, sizes: GraphSizes, where: str) -> ort.InferenceSession:
    """Open a step graph and run it a few times, so that the first step in a loop is not slower than the others.

    Raises:
        ModelError: if onnxruntime refuses the graph, or it does not keep the batch axis.
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = _SILENT
    try:
        session = ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        for batch in _WARM_UP:
            _check_batch(session, batch, sizes, where)
    except _ERRORS as error:
        text = " ".join(str(error).split())
        raise ModelError(f"{where}: onnxruntime refuses the graph: {text}") from None
    return session


def _check_batch(session: ort.InferenceSession, batch: int, sizes: GraphSizes, where: str) -> None:
    widths = {"u": sizes.inputs, "state": sizes.states, "theta": sizes.outputs, "next_state": sizes.states}
    expected = {key: (batch, width) for key, width in widths.items()}
    feed = {key: np.zeros(expected[key], sizes.dtype) for key in ("u", "state")}
    shapes = [np.asarray(result).shape for result in session.run(["theta", "next_state"], feed)]
    if shapes != [expected["theta"], expected["next_state"]]:
        raise ModelError(
            f"{where}: a batch of {batch} gives theta {shapes[0]} and next_state {shapes[1]}, "
            f"expected {expected['theta']} and {expected['next_state']}"
        )

"""A model file in onnxruntime: everything is checked before the first step, nothing in it is executed as code."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, final, get_args

import numpy as np
import onnx
import onnx.numpy_helper
import onnxruntime as ort
import onnxruntime.capi.onnxruntime_pybind11_state as state_
from numpy.typing import NDArray

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..model import LoadedModel
from .checks import check_graph, parse_model
from .metadata import ModelMetadata, Start

if TYPE_CHECKING:
    import casadi as ca


@final
class OnnxModel(LoadedModel):
    """A step graph, evaluated by onnxruntime on one thread; a float32 graph is fed float32, what comes back is float64.

    Attributes:
        graph: the ONNX graph, as `to_casadi` takes it.
        initializers: the graph's weights by name.
        dtype: number type of the graph, float32 or float64.
        hash: SHA-256 of the file.
        source: the file's path, for messages and reports.
        start: which of the two initial rules `initial` follows.
    """

    def __init__(self, content: bytes, source: str = "<memory>", start: Start = "initial") -> None:
        """Check the bytes of a model file and open it.

        Raises:
            ModelError: as `load_onnx` does, or if `start` is unknown.
        """
        if start not in get_args(Start):
            raise ModelError(f"{source}: start is {start!r}, available: conditioned, initial")
        proto = parse_model(content, source)
        # Damaged text arrives from protobuf as bytes; turned into str it is found to be neither our key nor JSON.
        properties = {str(entry.key): str(entry.value) for entry in proto.metadata_props}
        super().__init__(ModelMetadata.from_properties(properties, source), start)
        self.dtype = check_graph(proto, self.state_size, source)
        self.graph: onnx.GraphProto = proto.graph
        self.initializers: Mapping[str, NDArray[np.generic]] = {
            weight.name: onnx.numpy_helper.to_array(weight) for weight in proto.graph.initializer
        }
        self.hash: str = hashlib.sha256(content).hexdigest()
        self.source = source
        self.start: Start = start
        self._run = open_session(content, self.state_size, self.dtype, source).run

    @property
    def simulator(self) -> NoReturn:
        """A chain of operators has a readable form, an exported graph has none.

        Raises:
            ModelError: always.
        """
        raise ModelError(f"{self.source}: an exported model has no readable form, expected a simulator file (.yaml)")

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        """Angles (N, 1) [deg] and next states (N, S) from states (N, S) and commands (N, 1).

        Raises:
            ModelError: if the shapes are not (N, S) and (N, 1).
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
        """The step as `casadi.Function`: state (S, 1), u (1, 1) -> theta (1, 1), next_state (S, 1).

        Raises:
            ModelError: if a node cannot be translated; names the node.
        """
        from .casadi_ import to_casadi  # a control process that only steps does not need CasADi

        return to_casadi(self.graph, "model")


def load_onnx(path: Path | str, start: Start = "initial") -> OnnxModel:
    """Read a model that `export_onnx` wrote.

    Args:
        path: the ONNX file.
        start: "initial" for recorded trials of a device that was not flexed since it was set up, "conditioned" for
            a device that has done its initialisation flexure, as controllers find it.

    Raises:
        ModelError: if the file is missing, not ONNX or cut off, foreign (without the metadata), of another format
            version, has an operator outside the list, other inputs or outputs than the contract, weights that are not
            finite or lie outside the file. One line that says what was got and expected.
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


def open_session(content: bytes, state_size: int, dtype: np.dtype[np.generic], where: str) -> ort.InferenceSession:
    """Open a step graph and run it a few times, so that the first step in a loop is as fast as the rest.

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
            _check_batch(session, batch, state_size, dtype, where)
    except _ERRORS as error:
        text = " ".join(str(error).split())
        raise ModelError(f"{where}: onnxruntime refuses the graph: {text}") from None
    return session


def _check_batch(session: ort.InferenceSession, batch: int, state_size: int, dtype: np.dtype[Any], where: str) -> None:
    feed = {"u": np.zeros((batch, 1), dtype), "state": np.zeros((batch, state_size), dtype)}
    shapes = [np.asarray(result).shape for result in session.run(["theta", "next_state"], feed)]
    if shapes != [(batch, 1), (batch, state_size)]:
        raise ModelError(
            f"{where}: a batch of {batch} gives theta {shapes[0]} and next_state {shapes[1]}, "
            f"expected ({batch}, 1) and ({batch}, {state_size})"
        )

"""Reading a model file: everything is checked before the first step, and nothing in it is ever executed as code."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal, final

import numpy as np
import onnx
import onnx.numpy_helper
from numpy.typing import NDArray

from hystmpc.trials.errors import ModelError

from ..model import Array
from .checks import check_graph, parse_model
from .metadata import ModelMetadata
from .onnxruntime_ import open_session

if TYPE_CHECKING:
    import casadi as ca

Start = Literal["initial", "conditioned"]
_OUTPUTS = ["theta", "next_state"]


@final
class OnnxModel:
    """A step graph behind the `Model` protocol, evaluated by onnxruntime on one thread.

    The model's state is x = [state, theta] (N, S + 1): it carries the angle that it last produced, so that `output` is
    a projection. A float32 graph is fed float32; everything that comes back is float64.

    Attributes:
        metadata: what the file says about itself.
        graph: the ONNX graph, as `to_casadi` takes it.
        initializers: the graph's weights by name.
        hash: SHA-256 of the file.
        source: the file's path, for messages and reports.
        start: which of the two initial rules `initial` follows.
    """

    def __init__(self, content: bytes, source: str = "<memory>", start: Start = "initial") -> None:
        """Check the bytes of a model file and open it.

        Raises:
            ModelError: as `load_onnx` does, or if `start` is unknown.
        """
        if start not in ("initial", "conditioned"):
            raise ModelError(f"{source}: start is {start!r}, available: conditioned, initial")
        proto = parse_model(content, source)
        # Damaged text arrives from protobuf as bytes; turned into str it is found to be neither our key nor JSON.
        properties = {str(entry.key): str(entry.value) for entry in proto.metadata_props}
        self.metadata: ModelMetadata = ModelMetadata.from_properties(properties, source)
        self._dtype = check_graph(proto, self.metadata.state_size, source)
        self.graph: onnx.GraphProto = proto.graph
        self.initializers: Mapping[str, NDArray[np.generic]] = {
            weight.name: onnx.numpy_helper.to_array(weight) for weight in proto.graph.initializer
        }
        self.hash: str = hashlib.sha256(content).hexdigest()
        self.source = source
        self.start = start
        self._rule = self.metadata.initial if start == "initial" else self.metadata.conditioned
        self._size = self.metadata.state_size
        self._run = open_session(content, self._size, self._dtype, source).run

    @property
    def nx(self) -> int:
        """Entries of x: state and last angle."""
        return self._size + 1

    @property
    def nu(self) -> int:
        """Commands: one."""
        return 1

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self.metadata.dt_s

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """Number type of the graph, float32 or float64."""
        return self._dtype

    def initial(self, y: Array) -> Array:
        """State x (N, S + 1) of a device that rests at the measured angles `y` (N, 1) [deg]."""
        return np.concatenate([self._rule.state(y), y], axis=1)

    def step(self, x: Array, u: Array) -> Array:
        """State x (N, S + 1) one sample later under commands `u` (N, 1) [command unit]."""
        theta, state = self.advance(x[:, :-1], u)
        return np.concatenate([state, theta], axis=1)

    def output(self, x: Array) -> Array:
        """Tip angles (N, 1) [deg]."""
        return x[:, -1:]

    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        """Angles (N, 1) [deg] and next states (N, S) from states (N, S) and commands (N, 1).

        Raises:
            ModelError: if the shapes are not (N, S) and (N, 1).
        """
        if state.shape != (u.shape[0], self._size) or u.shape != (u.shape[0], 1):
            raise ModelError(
                f"{self.source}: got states {state.shape} and commands {u.shape}, expected (N, {self._size}) and (N, 1)"
            )
        feed = {"u": u.astype(self._dtype), "state": state.astype(self._dtype)}
        theta, following = self._run(_OUTPUTS, feed)
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

"""A model ready for export, and writing its file: only what equals its reference, and whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hystmpc.trials.errors import ExportError, ModelError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

from ..model import StepFunction
from .metadata import ModelMetadata

if TYPE_CHECKING:
    import onnx

    from .equivalence import EquivalenceReport


@dataclass(frozen=True)
class ExportBundle:
    """One model ready for export.

    Attributes:
        graph: inputs u [N,1] and state [N,S], outputs theta [N,1] and next_state [N,S], batch axis N symbolic, all
            four float32 or all four double, operators from the list; or a function that makes it.
        metadata: see `ModelMetadata`.
        reference: the implementation that the graph has to agree with.
        probe: commands (T,) [command unit], T >= 2, a persistent excitation inside the trained range.

    Raises:
        ExportError: if the parts do not fit each other.
    """

    graph: onnx.GraphProto | Callable[[], onnx.GraphProto]
    metadata: ModelMetadata
    reference: StepFunction
    probe: Vec

    def __post_init__(self) -> None:
        probe = np.array(self.probe, dtype=np.float64)
        probe.setflags(write=False)
        object.__setattr__(self, "probe", probe)
        trained = self.metadata.trained_command
        if probe.ndim != 1 or probe.size < 2:
            raise ExportError(f"probe has shape {probe.shape}, expected (T,) with T >= 2")
        outside = np.flatnonzero(~trained.contains(probe))
        if outside.size:
            k = int(outside[0])
            raise ExportError(
                f"probe is {probe[k]:.6g} {self.metadata.command_unit} at sample {k}, "
                f"expected the trained range {trained.lower:.6g} to {trained.upper:.6g}"
            )
        if self.reference.state_size != self.metadata.state_size:
            raise ExportError(
                f"reference has {self.reference.state_size} state entries, metadata {self.metadata.state_size}, "
                "expected as many"
            )


def export_onnx(bundle: ExportBundle, path: Path | str) -> EquivalenceReport:
    """Check a model, compare it with its reference and write it as an ONNX file.

    The file is judged in memory by what would load it, then by `check_equivalence`: 1,000 free-running steps, random
    states in batches of 1 and 8, onnxruntime and CasADi against the reference within 1e-3 deg, CasADi's Jacobians
    against the reference's.

    Returns:
        The largest differences seen.

    Raises:
        ExportError: if the graph breaks the contract or differs from the reference, or the file cannot be written; a
            file that lay at `path` before is left as it was.
    """
    from .equivalence import check_equivalence  # what the check needs is not loaded for a model that stays in memory
    from .load import OnnxModel

    try:
        content = model_bytes(bundle)
        report = check_equivalence(bundle.reference, OnnxModel(content, str(path)), bundle.probe)
    except ModelError as error:
        raise ExportError(f"{error}; nothing was written") from None
    except ExportError as error:
        raise ExportError(f"{path}: {error}; nothing was written") from None
    try:
        write_atomically(path, content)
    except OSError as error:
        raise ExportError(f"{path}: cannot be written ({error.strerror})") from None
    return report


def model_bytes(bundle: ExportBundle) -> bytes:
    """The model file of a bundle."""
    return graph_bytes(bundle.graph() if callable(bundle.graph) else bundle.graph, bundle.metadata)


def graph_bytes(graph: onnx.GraphProto, facts: ModelMetadata) -> bytes:
    """The model file of a graph and its facts."""
    import onnx.helper

    from .checks import IR_VERSION, OPSET

    proto = onnx.helper.make_model(
        graph,
        producer_name="hystmpc",
        opset_imports=[onnx.helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    onnx.helper.set_model_props(proto, facts.to_properties())
    return proto.SerializeToString(deterministic=True)

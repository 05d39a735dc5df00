"""Model files: opening any, a simulator in YAML or an export in ONNX, and exporting a simulator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.errors import ModelError

from .contract.export import ExportBundle, export_onnx
from .contract.metadata import Start
from .model import LoadedModel
from .motions import probe_commands
from .simulator import ChainModel, Simulator, load_simulator

if TYPE_CHECKING:
    import onnx

    from .contract.equivalence import EquivalenceReport


def load_model(path: Path | str, start: Start = "initial") -> LoadedModel:
    """Open a model by its ending.

    Args:
        path: `.yaml` or `.yml` for a simulator, `.onnx` for an exported model.
        start: rule for the state at the start, see `ModelMetadata`.

    Raises:
        ModelError: if the ending is another, or the file is missing, foreign or corrupt.
    """
    suffix = Path(path).suffix.lower()
    if suffix in (".yaml", ".yml"):
        return ChainModel(load_simulator(path), start)
    if suffix == ".onnx":
        from .contract.load import load_onnx  # onnxruntime is not loaded for a simulator

        return load_onnx(path, start)
    raise ModelError(f"{path}: ending {suffix or 'missing'}, expected a model file (.yaml simulator or .onnx)")


def simulator_bundle(simulator: Simulator) -> ExportBundle:
    """Graph, facts, reference and probe of a simulator, in double; the graph is made when it is exported."""
    model = ChainModel(simulator)

    def graph() -> onnx.GraphProto:
        from .contract.onnx_nodes import step_graph

        return step_graph(simulator.chain.bound(simulator.dt_s), model.metadata.kind)

    return ExportBundle(graph, model.metadata, model, probe_commands(model.metadata))


def export_simulator(simulator: Simulator, path: Path | str) -> EquivalenceReport:
    """Write a simulator as an ONNX model.

    Raises:
        ExportError: if the graph does not equal the simulator; nothing is written then.
    """
    return export_onnx(simulator_bundle(simulator), path)

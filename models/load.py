"""Opening any model file: a simulator in YAML or an exported network or operator in ONNX."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from hystmpc.trials.errors import ModelError

from .contract.bundle import ExportBundle
from .contract.equivalence import GateReport
from .contract.export import export_onnx
from .contract.load import OnnxModel, load_onnx
from .contract.onnx_nodes import step_graph
from .motions import probe_commands
from .simulator import ChainModel, Simulator, load_simulator

AnyModel = ChainModel | OnnxModel


def load_model(path: Path | str, start: Literal["initial", "conditioned"] = "initial") -> AnyModel:
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
        return load_onnx(path, start)
    raise ModelError(f"{path}: ending {suffix or 'missing'}, expected a model file (.yaml simulator or .onnx)")


def simulator_bundle(simulator: Simulator) -> ExportBundle:
    """Graph, facts, reference and probe of a simulator, in double."""
    model = ChainModel(simulator)
    graph = step_graph(simulator.chain.bound(simulator.dt_s), model.metadata.kind)
    return ExportBundle(graph, model.metadata, model, probe_commands(model.metadata))


def export_simulator(simulator: Simulator, path: Path | str) -> GateReport:
    """Write a simulator as an ONNX model.

    Raises:
        ExportError: if the numeric gate refuses; nothing is written then.
    """
    return export_onnx(simulator_bundle(simulator), path)

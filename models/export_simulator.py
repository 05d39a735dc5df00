"""A simulator as an ONNX model: its symbolic step translated node by node."""

from __future__ import annotations

from pathlib import Path

from .chain_model import ChainModel
from .contract.bundle import ExportBundle
from .contract.export import export_onnx
from .contract.gate import GateReport
from .probe import probe_commands
from .simulator import Simulator
from .symbolic.onnx_nodes import step_graph


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

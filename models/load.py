"""Model files of either kind: a simulator in YAML or an export in ONNX."""

from __future__ import annotations

from pathlib import Path

from hystmpc.trials.errors import ModelError

from .contract.metadata import Start
from .model import LoadedModel
from .simulator import ChainModel, load_simulator


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

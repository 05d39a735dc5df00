"""Opening any model file: a simulator in YAML or an exported network or operator in ONNX."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from hystmpc.trials.errors import ModelError

from .chain_model import ChainModel
from .contract.load import OnnxModel, load_onnx
from .simulator import load_simulator

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

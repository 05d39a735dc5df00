"""The ONNX contract: what a model file holds, the gate that it passes before it is written, how it is read again."""

from .bundle import ExportBundle
from .equivalence import GateReport
from .export import export_onnx
from .load import OnnxModel, load_onnx
from .metadata import InitialRule, ModelMetadata, Range

__all__ = [
    "ExportBundle",
    "GateReport",
    "InitialRule",
    "ModelMetadata",
    "OnnxModel",
    "Range",
    "export_onnx",
    "load_onnx",
]

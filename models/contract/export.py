"""Writing a model file: only after the numeric gate has passed, and whole or not at all."""

from __future__ import annotations

from pathlib import Path

import onnx
import onnx.helper

from hystmpc.trials.errors import ExportError, ModelError
from hystmpc.trials.files import write_atomically

from .bundle import ExportBundle
from .checks import IR_VERSION, OPSET
from .gate import GateReport, run_gate
from .load import OnnxModel


def export_onnx(bundle: ExportBundle, path: Path | str) -> GateReport:
    """Check a model, compare it with its reference and write it as an ONNX file.

    The file is judged in memory by what would load it, then by the numeric gate: 1,000 free-running steps, random
    states in batches of 1 and 8, onnxruntime and CasADi against the reference within 1e-3 deg, CasADi's Jacobians
    against the reference's.

    Returns:
        The largest differences seen.

    Raises:
        ExportError: if the graph breaks the contract or differs from the reference, or the file cannot be written; a
            file that lay at `path` before is left as it was.
    """
    try:
        content = model_bytes(bundle)
        report = run_gate(bundle, OnnxModel(content, str(path)))
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
    proto = onnx.helper.make_model(
        bundle.graph,
        producer_name="hystmpc",
        opset_imports=[onnx.helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    onnx.helper.set_model_props(proto, bundle.metadata.to_properties())
    return proto.SerializeToString(deterministic=True)

"""`hystmpc export`: a simulator becomes an ONNX model, if it passes the numeric gate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.models.contract.load import load_onnx
from hystmpc.tasks.export import export as export_model

from .bars import bar
from .console import out
from .options import Force


def export(
    simulator: Annotated[
        Path, typer.Argument(metavar="SIMULATOR", help="A simulator (.yaml of `fit`, or builtin:NAME).")
    ],
    path: Annotated[Path, typer.Option("--out", help="The ONNX file to write.")],
    force: Force = False,
) -> None:
    """Export a simulator as a stateful ONNX step.

    It is held against its reference in onnxruntime and CasADi before it is written.
    """
    with bar("compare and export"):
        gate = export_model(simulator, path, force=force)
    out.print(
        f"{path}: {gate.steps} steps within {max(gate.runtime_deg, gate.casadi_deg):.2g} deg of the reference "
        f"(onnxruntime {gate.runtime_deg:.2g}, CasADi {gate.casadi_deg:.2g}), Jacobians within {gate.jacobian:.2g}; "
        f"sha256 {load_onnx(path).hash[:12]}",
        soft_wrap=True,
    )

"""`hystmpc export-c`: the controller of a `tip.yaml` becomes one C99 file and its header."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .bars import bar
from .console import out
from .options import C_HEADER, C_SOURCE, Force, check_output


def export_c(
    settings: Annotated[Path, typer.Argument(metavar="TIP", help="Settings of a controller, as a planner gives them.")],
    folder: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for hystmpc.c and hystmpc.h.")],
    single: Annotated[bool, typer.Option("--float32", help="float in the place of double.")] = False,
    force: Force = False,
) -> None:
    """Export a predictive controller as C99: one file and its header, without heap or further libraries.

    Its commands are those of the Python controller.
    """
    from hystmpc.codegen import export_controller

    header, source = folder / "hystmpc.h", folder / "hystmpc.c"
    check_output("--out", header, (C_HEADER,), [settings], force)
    check_output("--out", source, (C_SOURCE,), [settings], force)
    with bar("export"):
        found = export_controller(settings, single=single)
        found.write(folder)
    scalar = "float" if single else "double"
    inexact = f" (last digits vary: {', '.join(found.inexact)})" if found.inexact else ""
    out.print(
        f"{source}, {header}: a step every {found.sample_s:g} s, {found.reference_samples} samples of reference, "
        f"{scalar}; {found.memory_bytes} bytes, of which {found.remembered_bytes} are remembered; "
        f"calls {', '.join(found.functions)} of <math.h>{inexact}",
        soft_wrap=True,
        markup=False,
        highlight=False,
    )

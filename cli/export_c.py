"""`hystmpc export-c`: the controller of a `tip.yaml` becomes one C99 file and its header."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.tasks.export import export_c as export_controller

from .bars import bar
from .console import out
from .options import Force


def export_c(
    settings: Annotated[Path, typer.Argument(metavar="TIP", help="Settings of a controller, as a planner gives them.")],
    folder: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for hystmpc.c and hystmpc.h.")],
    single: Annotated[bool, typer.Option("--float32", help="float in the place of double.")] = False,
    force: Force = False,
) -> None:
    """Export a predictive controller as C99: one file and its header, without heap or further libraries.

    Its commands are those of the Python controller.
    """
    with bar("export"):
        made = export_controller(settings, folder, single=single, force=force)
    inexact = f" (last digits vary: {', '.join(made.inexact)})" if made.inexact else ""
    out.print(
        f"{folder / 'hystmpc.c'}, {folder / 'hystmpc.h'}: a step every {made.sample_s:g} s, {made.reference_samples} "
        f"samples of reference, {'float' if single else 'double'}; {made.memory_bytes} bytes, of which "
        f"{made.remembered_bytes} are remembered; calls {', '.join(made.functions)} of <math.h>{inexact}",
        soft_wrap=True,
        markup=False,
        highlight=False,
    )

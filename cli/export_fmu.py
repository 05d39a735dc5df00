"""`hystmpc export-fmu`: a simulator with its effects becomes a co-simulation FMU."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hystmpc.tasks.export import export_fmu as export_plant

from .bars import bar
from .console import out
from .options import Force


class Fmi(StrEnum):
    """Versions of the standard."""

    V2 = "2.0"
    V3 = "3.0"


def export_fmu(
    simulator: Annotated[
        Path,
        typer.Argument(metavar="SIM", help="A simulator (.yaml, or builtin:NAME), or the file of a closed-loop study."),
    ],
    path: Annotated[Path, typer.Option("--out", help="The FMU to write, .fmu.")],
    fmi: Annotated[Fmi, typer.Option("--fmi", help="Version of the standard.")] = Fmi.V2,
    platforms: Annotated[
        list[str] | None,
        typer.Option("--platform", help="Binary to make: linux64, win64, darwin64; this machine's where left out."),
    ] = None,
    force: Force = False,
) -> None:
    """Export a simulator with its effects as a co-simulation FMU.

    Its input is the command, its output the true angle without the noise of a sensor. The FMU holds its C sources, and
    a binary where a compiler is found: CC, cc, or the package ziglang.
    """
    with bar("export"):
        made = export_plant(simulator, path, fmi=fmi.value, platforms=platforms, force=force)
    facts = made.described
    binaries = (
        f"binaries {', '.join(made.platforms)}"
        if made.platforms
        else "sources only: no C compiler was found for this machine"
    )
    calls = f"; calls {', '.join(made.functions)} of <math.h>" if made.functions else ""
    left_out = f"; left out: {', '.join(made.left_out)}" if made.left_out else ""
    out.print(
        f"{path}: FMI {fmi}, co-simulation, a step every {facts.sample_s:g} s, command [{facts.command_unit}] to "
        f"{facts.output} [{facts.output_unit}]; {binaries}{calls}{left_out}",
        soft_wrap=True,
        markup=False,
        highlight=False,
    )

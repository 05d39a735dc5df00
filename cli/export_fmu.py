"""`hystmpc export-fmu`: a simulator with its effects becomes a co-simulation FMU."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .bars import bar
from .console import out
from .options import FMU, Force, check_output

if TYPE_CHECKING:
    from hystmpc.sim.config import PlantSettings
    from hystmpc.sim.plants.simulated import SimulatedPlant


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
    from hystmpc.codegen import export_fmu as exported

    check_output("--out", path, (FMU,), [simulator], force)
    plant = _plant(simulator)
    with bar("export"):
        export = exported(
            plant.simulator,
            plant.rest,
            name=path.stem,
            version=fmi.value,
            platforms=platforms,
            rest_command=plant.rest_command,
        )
        export.write(path)
    found = export.described
    binaries = (
        f"binaries {', '.join(export.platforms)}"
        if export.platforms
        else "sources only: no C compiler was found for this machine"
    )
    calls = f"; calls {', '.join(export.functions)} of <math.h>" if export.functions else ""
    left = ", ".join(_left_out(plant))
    out.print(
        f"{path}: FMI {fmi}, co-simulation, a step every {found.sample_s:g} s, command [{found.command_unit}] to "
        f"{found.output} [{found.output_unit}]; {binaries}{calls}{f'; left out: {left}' if left else ''}",
        soft_wrap=True,
        markup=False,
        highlight=False,
    )


def _plant(source: Path) -> SimulatedPlant:
    """The plant of a study, or a simulator alone.

    Raises:
        ExportError: if it is not made of operators.
    """
    from hystmpc.sim.plants.make import make_plant
    from hystmpc.sim.plants.simulated import SimulatedPlant
    from hystmpc.trials.errors import ExportError

    settings = _settings(source)
    plant = None if settings.device else make_plant(settings)
    if not isinstance(plant, SimulatedPlant):
        raise ExportError(
            f"export-fmu: got plant.device {settings.device}, supported are simulators: chains of operators"
        )
    return plant


def _settings(source: Path) -> PlantSettings:
    from hystmpc.models.load import BUILTIN
    from hystmpc.sim.config import PlantSettings, load_simulation
    from hystmpc.trials.config import read_yaml
    from hystmpc.trials.errors import ExportError

    if str(source).startswith(BUILTIN):
        return PlantSettings(simulator=str(source))
    if source.suffix.lower() not in (".yaml", ".yml"):
        raise ExportError(f"export-fmu: got {source}, supported are simulators and studies (.yaml) and builtin:NAME")
    data = read_yaml(source)
    if isinstance(data, Mapping) and "plant" in data:
        return load_simulation(source).plant
    return PlantSettings(simulator=str(source))


def _left_out(plant: SimulatedPlant) -> list[str]:
    """What the plant has and the FMU has not."""
    sensing = plant.sensing
    found = [f"noise of {sensing.noise_deg:g} deg"] if sensing.noise_deg else []
    found += [f"steps of {sensing.quantisation_deg:g} deg"] if sensing.quantisation_deg else []
    return [*found, *("a sensor" for _ in sensing.sensors[:1])]

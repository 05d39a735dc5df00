"""Export of a model: an ONNX step, a controller as C99, a simulator with its effects as an FMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ExportError

from .outputs import C_CODE, FMU, MODEL, check_output

if TYPE_CHECKING:
    from hystmpc.codegen.controller import ControllerExport
    from hystmpc.codegen.fmu.export import FmuExport
    from hystmpc.ctrl.planner.settings import TipSettings
    from hystmpc.models.contract.export import EquivalenceReport
    from hystmpc.models.simulator import Simulator
    from hystmpc.sim.config import PlantSettings
    from hystmpc.sim.plants.simulated import SimulatedPlant

    from .fit import Fit


def export(model: Fit | Simulator | Path | str, out: Path | str, *, force: bool = False) -> EquivalenceReport:
    """Write a model as an ONNX file of one stateful step, after a numeric comparison with its reference.

    Args:
        model: a fit, a simulator or a simulator file.
        out: the ONNX file to write.
        force: replace an older file of the same kind; never one of another.

    Returns:
        The largest differences between onnxruntime, CasADi and the reference.

    Raises:
        ConfigError: if the file may not be written.
        ExportError: if they disagree; nothing is written then.
        ModelError: if a file is no simulator.
    """
    from hystmpc.models.contract.export import export_onnx
    from hystmpc.models.load import model_path
    from hystmpc.models.simulator import export_simulator, load_simulator

    from .fit import Fit

    check_output("--out", out, (MODEL,), [Path(model)] if isinstance(model, Path | str) else (), force)
    if isinstance(model, Fit):
        return export_onnx(model.identified.bundle, out)
    return export_simulator(load_simulator(model_path(str(model))) if isinstance(model, Path | str) else model, out)


def export_c(
    settings: Path | str | Mapping[str, Any] | TipSettings,
    out: Path | str,
    *,
    single: bool = False,
    force: bool = False,
) -> ControllerExport:
    """Write a predictive controller as C99: hystmpc.c and hystmpc.h, without heap or further libraries.

    Its commands are those of `TipController.from_config(settings)`. A model of two axes has arrays of both axes.

    Args:
        settings: of the controller, as a planner gives them: a `tip.yaml` or a mapping.
        out: folder for hystmpc.c and hystmpc.h.
        single: float in the place of double.
        force: replace older files of the same kind; never those of another.

    Raises:
        ConfigError: if a setting is wrong or a file may not be written.
        ExportError: if a part of the controller has no C form; names it and the supported ones.
        ModelError, ControllerError: as `TipController.from_config`.
    """
    from hystmpc.codegen import export_controller

    inputs = [Path(settings)] if isinstance(settings, Path | str) else []
    for name in ("hystmpc.h", "hystmpc.c"):
        check_output("--out", Path(out) / name, (C_CODE,), inputs, force)
    made = export_controller(settings, single=single)
    made.write(Path(out))
    return made


def export_fmu(
    simulator: Simulator | SimulatedPlant | Path | str,
    out: Path | str,
    *,
    fmi: Literal["2.0", "3.0"] = "2.0",
    platforms: Sequence[str] | None = None,
    force: bool = False,
) -> FmuExport:
    """Write a simulator with its effects as a co-simulation FMU.

    Its input is the command, its output the true angle without the noise of a sensor. The FMU holds its C sources, and
    a binary if a compiler is available: CC, cc, or the package ziglang.

    Args:
        simulator: a simulator, a simulated plant, a simulator file, `builtin:NAME`, or the file of a study.
        out: the FMU to write, .fmu.
        fmi: version of the standard.
        platforms: binary to make: linux64, win64, darwin64; this machine's where left out.
        force: replace an older file of the same kind; never one of another.

    Raises:
        ConfigError: if the file may not be written.
        ExportError: if the plant is not made of operators, or a platform is unknown.
        ModelError: if a simulator cannot be used.
    """
    from hystmpc.codegen import export_fmu as exported

    path = Path(out)
    check_output("--out", path, (FMU,), [Path(simulator)] if isinstance(simulator, Path | str) else (), force)
    plant = _plant(simulator)
    made = exported(
        plant.simulator, plant.rest, name=path.stem, version=fmi, platforms=platforms, rest_command=plant.rest_command
    )
    made.write(path)
    return replace(made, left_out=_left_out(plant))


def _plant(source: Simulator | SimulatedPlant | Path | str) -> SimulatedPlant:
    """The plant of a study, or a simulator alone; refuse a model without operators."""
    from hystmpc.sim.plants.device import make_plant
    from hystmpc.sim.plants.simulated import SimulatedPlant

    if isinstance(source, SimulatedPlant):
        return source
    if not isinstance(source, Path | str):
        return SimulatedPlant(source)
    settings = _plant_settings(Path(source))
    plant = None if settings.device else make_plant(settings)
    if not isinstance(plant, SimulatedPlant):
        raise ExportError(
            f"export-fmu: got plant.device {settings.device}, supported are simulators: chains of operators"
        )
    return plant


def _plant_settings(source: Path) -> PlantSettings:
    from hystmpc.models.load import BUILTIN
    from hystmpc.models.two_axes.model import has_two_axes
    from hystmpc.sim.config import PlantSettings, load_simulation
    from hystmpc.sim.two_axes.config import file_of_two_axes

    if str(source).startswith(BUILTIN):
        return PlantSettings(simulator=str(source))
    if source.suffix.lower() not in (".yaml", ".yml"):
        raise ExportError(f"export-fmu: got {source}, supported are simulators and studies (.yaml) and builtin:NAME")
    if has_two_axes(source) or file_of_two_axes(source):
        raise ExportError(f"export-fmu: got two axes in {source}, supported is one axis: a simulator or its study")
    data = read_yaml(source)
    if isinstance(data, Mapping) and "plant" in data:
        return load_simulation(source).plant
    return PlantSettings(simulator=str(source))


def _left_out(plant: SimulatedPlant) -> tuple[str, ...]:
    sensing = plant.sensing
    parts = [f"noise of {sensing.noise_deg:g} deg"] if sensing.noise_deg else []
    parts += [f"steps of {sensing.quantisation_deg:g} deg"] if sensing.quantisation_deg else []
    return (*parts, *("a sensor" for _ in sensing.sensors[:1]))

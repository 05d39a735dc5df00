"""Export of a model: an ONNX step, a controller as C99, a simulator with its effects as an FMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ExportError

from .outputs import C_CODE, FMU, MODEL, check_output

if TYPE_CHECKING:
    from hystmpc.codegen.controller import ControllerExport
    from hystmpc.codegen.fmu import DeviceInPlane, FmuExport
    from hystmpc.ctrl.planner.settings import TipSettings
    from hystmpc.models.contract.export import EquivalenceReport
    from hystmpc.models.simulator import Simulator
    from hystmpc.models.two_axes.model import TwoAxisModel
    from hystmpc.sim.config import PlantSettings
    from hystmpc.sim.plants.computed import Sensing
    from hystmpc.sim.plants.simulated import SimulatedPlant
    from hystmpc.sim.two_axes.config import TwoAxisPlantSettings

    from .fit import Fit


def export(
    model: Fit | Simulator | TwoAxisModel | Path | str, out: Path | str, *, force: bool = False
) -> EquivalenceReport:
    """Write a model as an ONNX file of one stateful step, after a numeric comparison with its reference.

    Args:
        model: a fit, a simulator, a model of two axes, or a file of either.
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
    from hystmpc.models.two_axes.exported import export_two_axes
    from hystmpc.models.two_axes.model import TwoAxisModel, has_two_axes, load_two_axes

    from .fit import Fit

    check_output("--out", out, (MODEL,), [Path(model)] if isinstance(model, Path | str) else (), force)
    if isinstance(model, Fit):
        return export_onnx(model.identified.bundle, out)
    if isinstance(model, TwoAxisModel):
        return export_two_axes(model, out)
    if isinstance(model, Path | str) and has_two_axes(model):
        return export_two_axes(load_two_axes(model), out)
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
    simulator: Simulator | SimulatedPlant | TwoAxisModel | Path | str,
    out: Path | str,
    *,
    fmi: Literal["2.0", "3.0"] = "2.0",
    platforms: Sequence[str] | None = None,
    force: bool = False,
) -> FmuExport:
    """Write a simulator with its effects as a co-simulation FMU.

    Its input is the command, its output the true angle without the noise of a sensor; of two axes all commands and both
    angles. The FMU holds its C sources, and a binary if a compiler is available: CC, cc, or the package ziglang.

    Args:
        simulator: a simulator, a simulated plant, a model of two axes, a file of either, `builtin:NAME`, or the file of
            a study.
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
    from hystmpc.codegen import export_fmu_in_plane

    path = Path(out)
    check_output("--out", path, (FMU,), [Path(simulator)] if isinstance(simulator, Path | str) else (), force)
    if in_plane := _in_plane(simulator):
        device, sensing = in_plane
        made = export_fmu_in_plane(device, name=path.stem, version=fmi, platforms=platforms)
    else:
        plant = _plant(cast("Simulator | SimulatedPlant | Path | str", simulator))
        sensing, rest = plant.sensing, plant.rest_command
        made = exported(
            plant.simulator, plant.rest, name=path.stem, version=fmi, platforms=platforms, rest_command=rest
        )
    made.write(path)
    return replace(made, left_out=_left_out(sensing))


def _in_plane(source: object) -> tuple[DeviceInPlane, Sensing] | None:
    """Device of two axes and its sensor, of a model, a model's file or a study; None where there is one axis."""
    from hystmpc.models.two_axes.model import TwoAxisModel, has_two_axes, load_two_axes
    from hystmpc.sim.two_axes.config import TwoAxisPlantSettings, file_of_two_axes, load_two_axis_simulation

    if isinstance(source, TwoAxisModel):
        return device_in_plane(source, TwoAxisPlantSettings(simulator="model"))
    if not isinstance(source, Path | str):
        return None
    if has_two_axes(source):
        return device_in_plane(load_two_axes(source), TwoAxisPlantSettings(simulator=str(source)))
    if Path(source).suffix.lower() in (".yaml", ".yml") and file_of_two_axes(source):
        settings = load_two_axis_simulation(source).plant
        return device_in_plane(load_two_axes(settings.simulator), settings)
    return None


def device_in_plane(model: TwoAxisModel, settings: TwoAxisPlantSettings) -> tuple[DeviceInPlane, Sensing]:
    """Return the device of `TwoAxisPlant` after a reset, for an FMU, and its sensor.

    Raises:
        ConfigError, ModelError: as `TwoAxisPlant`.
    """
    from hystmpc.codegen import DeviceInPlane
    from hystmpc.models.contract.metadata import Range
    from hystmpc.models.operators.dynamics import stored
    from hystmpc.sim.plants.computed import OperatorCascade, Sensing
    from hystmpc.sim.plants.simulated import Effects, conditioned, fresh, plant_simulator
    from hystmpc.sim.two_axes.plant import TwoAxisPlant

    plant, dt_s = TwoAxisPlant(model, settings), model.dt_s
    commands, axes, states = plant.rest_command, [], []
    for k, changes in enumerate((settings.x, settings.y)):
        low, high, _ = model.travel_limits()[k]
        axis = plant_simulator(model.axes[k], Effects(**changes.model_dump()), dt_s)
        axis = replace(axis, rest_command=float(model.travels(commands)[k]))
        axes.append(axis)
        states.append((fresh if settings.virgin else conditioned)(axis, Range(lower=low, upper=high))[1])
    drive = stored(Effects(lag_s=settings.lag_s, delay_s=settings.delay_s).actuator, dt_s)
    driven, shared = OperatorCascade(drive, dt_s), model.cross_friction
    device = DeviceInPlane(
        replace(model, axes=(axes[0], axes[1])),
        drive,
        plant.true_angle,
        tuple(driven.at_rest(float(u)) for u in commands),
        (states[0], states[1]),
        np.empty(0) if shared is None else shared.at_rest(model.travels(commands), dt_s),
    )
    return device, Sensing(settings.noise_deg, settings.quantisation_deg)


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
    from hystmpc.sim.config import PlantSettings, load_simulation

    if str(source).startswith(BUILTIN):
        return PlantSettings(simulator=str(source))
    if source.suffix.lower() not in (".yaml", ".yml"):
        raise ExportError(f"export-fmu: got {source}, supported are simulators and studies (.yaml) and builtin:NAME")
    data = read_yaml(source)
    if isinstance(data, Mapping) and "plant" in data:
        return load_simulation(source).plant
    return PlantSettings(simulator=str(source))


def _left_out(sensing: Sensing) -> tuple[str, ...]:
    parts = [f"noise of {sensing.noise_deg:g} deg"] if sensing.noise_deg else []
    parts += [f"steps of {sensing.quantisation_deg:g} deg"] if sensing.quantisation_deg else []
    return (*parts, *("a sensor" for _ in sensing.sensors[:1]))

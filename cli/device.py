"""`hystmpc device`: a simulated device in a process of its own, behind UDP or DDS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from hystmpc.ctrl.protocols import Plant
from hystmpc.rig.device.config import DeviceSettings
from hystmpc.rig.transports.link import DeviceLink
from hystmpc.rig.transports.settings import SimulatedSettings
from hystmpc.trials.config import load_settings
from hystmpc.trials.errors import ConfigError, did_you_mean

from .console import out

_OWN = ("device", "noise_deg", "quantisation_deg")
_DEVICES = ("tendon", "muscle", "rod")


def device(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="Plant, link and faults (YAML).")],
    overrides: Annotated[list[str] | None, typer.Option("--set", help="Change a setting: link.bind_port=0.")] = None,
    seconds: Annotated[float, typer.Option(min=0, help="End after this time; 0 for Ctrl-C.")] = 0.0,
) -> None:
    """Serve a simulated device until Ctrl-C; it listens on the loopback unless told otherwise."""
    from hystmpc.rig.device.server import serve

    settings = load_settings(DeviceSettings, config, overrides or ())
    folder = config.resolve().parent
    if settings.log is not None:
        settings = settings.model_copy(update={"log": folder / settings.log})
    plant, held = make_plant(settings.plant, settings.dt_s, settings.seed, folder, settings.command_unit)

    def ready(link: DeviceLink) -> None:
        port = getattr(link, "port", None)
        where = "dds" if port is None else f"udp port {port}"
        out.print(
            f"device ready: {where}, {settings.rate_hz:g} Hz, holds {held:g} {settings.command_unit}", soft_wrap=True
        )

    served = serve(settings, plant, held, ready, seconds or float("inf"))
    rejected = ", ".join(f"{count} {cause}" for cause, count in served.rejected.items()) or "none"
    out.print(
        f"{served.samples} samples, {served.commands} commands, {served.beyond} of them beyond the limits; "
        f"controller silent {served.watchdog} times; rejected: {rejected}",
        soft_wrap=True,
    )


def make_plant(settings: Mapping[str, Any], dt_s: float, seed: int, folder: Path, unit: str) -> tuple[Plant, float]:
    """The plant that a block `plant` describes, and the command that it holds after a reset.

    Args:
        settings: `simulator` and effects as in a simulation file, or `device` with `noise_deg`, `quantisation_deg`.
        dt_s: sample time [s].
        seed: of its noise.
        folder: where relative file names start.
        unit: of the command, which the plant has to have.

    Raises:
        ConfigError: on an unknown device or key, or another unit.
        ModelError: if a simulator file is missing or unusable.
    """
    if "device" in settings:
        return _device_plant(settings, dt_s, seed, unit)
    from hystmpc.models.library import model_path
    from hystmpc.models.simulator import load_simulator
    from hystmpc.sim.config import PlantSettings
    from hystmpc.sim.plant import Effects, SimulatedPlant

    block = PlantSettings.parse(dict(settings), "plant")
    simulator = load_simulator(model_path(block.simulator, folder))
    _same_unit(simulator.command_unit, unit)
    values = {name: value for name, value in block.model_dump().items() if name != "simulator"}
    plant = SimulatedPlant(simulator, Effects(**values), dt_s=dt_s, seed=seed)
    return plant, plant.rest_command


def plants_in(folder: Path, unit: str) -> Any:
    """A factory for transports of `kind: simulated`."""
    return lambda settings, dt_s: _simulated(settings, dt_s, folder, unit)


def _simulated(settings: SimulatedSettings, dt_s: float, folder: Path, unit: str) -> tuple[Plant, float]:
    return make_plant(settings.plant, dt_s, settings.seed, folder, unit)


def _device_plant(settings: Mapping[str, Any], dt_s: float, seed: int, unit: str) -> tuple[Plant, float]:
    from hystmpc.sim.devices.muscle import MuscleCatheter
    from hystmpc.sim.devices.plant import DevicePlant
    from hystmpc.sim.devices.rod import RodCatheter
    from hystmpc.sim.devices.tendon import TendonCatheter

    for key in settings:
        if key not in _OWN:
            raise ConfigError(f"plant: unknown key {key!r}, {did_you_mean(str(key), _OWN)}")
    name = str(settings["device"])
    kinds = {"tendon": TendonCatheter, "muscle": MuscleCatheter, "rod": RodCatheter}
    if name not in kinds:
        raise ConfigError(f"plant.device: got {name!r}, {did_you_mean(name, _DEVICES)}")
    made = kinds[name]()
    _same_unit(made.command_unit, unit)
    numbers = {key: float(settings[key]) for key in _OWN[1:] if key in settings}
    plant = DevicePlant(made, dt_s, seed=seed, **numbers)
    return plant, plant.rest_command


def _same_unit(got: str, expected: str) -> None:
    if got != expected:
        raise ConfigError(f"plant: got a device with commands in {got}, expected command_unit {expected}")

"""`hystmpc device`: a simulated device in a process of its own, behind UDP or DDS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from hystmpc.ctrl.loop import Plant
from hystmpc.rig.device.config import DeviceSettings
from hystmpc.rig.transports.simulated import SimulatedSettings
from hystmpc.rig.transports.transport import DeviceLink
from hystmpc.trials.config import load_settings
from hystmpc.trials.errors import ConfigError

from .at_bench import tell
from .console import out

_NOISE_DEG = 0.05  # of a device that is told none: an angle that never changes would be taken for a dead sensor


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

    served = serve(settings, plant, held, ready, seconds or float("inf"), tell)
    rejected = ", ".join(f"{count} {cause}" for cause, count in served.rejected.items()) or "none"
    out.print(
        f"{served.samples} samples, {served.commands} commands, {served.beyond} of them beyond the limits; "
        f"controller silent {served.watchdog} times; rejected: {rejected}",
        soft_wrap=True,
    )


def make_plant(settings: Mapping[str, Any], dt_s: float, seed: int, folder: Path, unit: str) -> tuple[Plant, float]:
    """The plant that a block `plant` describes, and the command that it holds after a reset.

    Args:
        settings: `simulator` or `device`, parameters and effects as in a simulation file.
        dt_s: sample time [s].
        seed: of its noise.
        folder: where relative file names start.
        unit: of the command, which the plant has to have.

    Raises:
        ConfigError: on an unknown device, key or parameter, a value out of bounds, or another unit.
        ModelError: if a simulator file is missing or unusable.
    """
    from hystmpc.models.load import model_path
    from hystmpc.sim.config import PlantSettings
    from hystmpc.sim.plants.make import make_plant as make

    noise = {"noise_deg": _NOISE_DEG} if "device" in settings else {}
    block = PlantSettings.parse(noise | dict(settings), "plant")
    if block.simulator is not None:
        block = block.model_copy(update={"simulator": str(model_path(block.simulator, folder))})
    plant = make(block, dt_s, seed=seed)
    if plant.command_unit != unit:
        raise ConfigError(f"plant: got a device with commands in {plant.command_unit}, expected command_unit {unit}")
    return plant, plant.rest_command


def plants_in(folder: Path, unit: str) -> Any:
    """A factory for transports of `kind: simulated`."""
    return lambda settings, dt_s: _simulated(settings, dt_s, folder, unit)


def _simulated(settings: SimulatedSettings, dt_s: float, folder: Path, unit: str) -> tuple[Plant, float]:
    return make_plant(settings.plant, dt_s, settings.seed, folder, unit)

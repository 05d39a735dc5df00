"""Simulated devices for the transport `kind: simulated`; made here, since `rig` does not import simulators."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hystmpc.ctrl.loop import Plant
from hystmpc.rig.transports.simulated import SimulatedSettings
from hystmpc.rig.transports.transport import PlantFactory
from hystmpc.trials.errors import ConfigError

_NOISE_DEG = 0.05  # default: an angle that never changes would be taken for a dead sensor


def make_plant(settings: Mapping[str, Any], dt_s: float, seed: int, folder: Path, unit: str) -> tuple[Plant, float]:
    """Plant of a block `plant`, and the command that it holds after a reset.

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
    from hystmpc.models.load import model_path  # simulators take long to import, and most benches have a device
    from hystmpc.sim.config import PlantSettings
    from hystmpc.sim.plants.device import make_plant as make

    noise = {"noise_deg": _NOISE_DEG} if "device" in settings else {}
    block = PlantSettings.parse(noise | dict(settings), "plant")
    if block.simulator is not None:
        block = block.model_copy(update={"simulator": str(model_path(block.simulator, folder))})
    plant = make(block, dt_s, seed=seed)
    if plant.command_unit != unit:
        raise ConfigError(f"plant: got a device with commands in {plant.command_unit}, expected command_unit {unit}")
    return plant, plant.rest_command


def plants_in(folder: Path, unit: str) -> PlantFactory:
    """Factory of simulated devices for the transport `kind: simulated`."""

    def made(settings: SimulatedSettings, dt_s: float) -> tuple[Plant, float]:
        return make_plant(settings.plant, dt_s, settings.seed, folder, unit)

    return made

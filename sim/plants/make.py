"""Plants from settings: a simulator file, or a device by name."""

from __future__ import annotations

from pathlib import Path

from hystmpc.models.contract.metadata import Range
from hystmpc.models.load import model_path
from hystmpc.models.simulator import load_simulator
from hystmpc.trials.json_text import file_hash, json_hash

from ..config import PlantSettings
from ..devices.names import DEVICES, named_device, plain_parameters
from .computed import ComputedPlant
from .device import DevicePlant
from .simulated import Effects, SimulatedPlant

_NAMES = {"simulator", "device", "parameters"}


def make_plant(
    settings: PlantSettings, dt_s: float | None = None, commands: Range | None = None, seed: int = 0
) -> ComputedPlant:
    """The plant of a study.

    Args:
        dt_s: sample time [s]; a simulator's own, or 0.04 s, where left out.
        commands: between which it is flexed and rests; its own limits where left out.

    Raises:
        ConfigError: if a mismatch names an unknown parameter, or the commands lie beyond what a device takes.
        ModelError: if a simulator file is missing or unusable, or a mismatch takes a parameter out of its bounds.
    """
    effects = settings.model_dump(exclude=_NAMES)
    if settings.device is None:
        return SimulatedPlant(load_simulator(_file(settings)), Effects(**effects), dt_s, commands, seed)
    device = named_device(settings.device, settings.parameters, effects.pop("mismatch"))
    return DevicePlant(device, Effects(**effects), 0.04 if dt_s is None else dt_s, commands, seed)


def plant_files(settings: PlantSettings) -> tuple[Path, ...]:
    """Files that the plant is read from.

    Raises:
        ModelError: on an unknown built-in model.
    """
    return (_file(settings),) if settings.device is None else ()


def plant_hash(settings: PlantSettings) -> str:
    """SHA-256 of what the settings do not hold: the simulator file, or all numbers of the device.

    Raises:
        ConfigError: if a file cannot be read, or a device's numbers are wrong.
        ModelError: on an unknown built-in model.
    """
    if settings.device is None:
        return file_hash(_file(settings))
    numbers = plain_parameters(settings.device, settings.parameters, settings.mismatch)
    return json_hash([settings.device, numbers])


def varied_parameters(settings: PlantSettings) -> tuple[str, ...]:
    """Names under `mismatch` of what differs between specimens of the plant.

    Raises:
        ModelError: if a simulator file is missing or unusable.
    """
    if settings.device is None:
        return load_simulator(_file(settings)).chain.labels
    return DEVICES[settings.device].varied


def _file(settings: PlantSettings) -> Path:
    return model_path(str(settings.simulator))

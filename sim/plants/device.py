"""Plants from settings: a simulator file, or a named device with separate physics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import final

import numpy as np

from hystmpc.models.contract.metadata import Range
from hystmpc.models.load import model_path
from hystmpc.models.operators.dynamics import stored
from hystmpc.models.simulator import load_simulator
from hystmpc.trajectories.excitation import s2_initialisation
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.json_text import file_hash, json_hash
from hystmpc.trials.types import Vec

from ..config import PlantSettings
from ..devices.device import Device
from ..devices.names import DEVICES, named_device, plain_parameters
from .computed import ComputedPlant, OperatorCascade
from .simulated import Effects, SimulatedPlant

_REST_S = 5.0


@dataclass(frozen=True, eq=False)
class DeviceState:
    """State of a device with effects: operators on its command, the device, operators on its angle."""

    command: Vec
    device: Vec
    output: Vec


@final
class DevicePlant(ComputedPlant):
    """Plant of a `Device`, with effects of the library on command and angle.

    Before every run the device does its initialisation flexure (one period of 0.1 Hz over the commands) and rests at
    the lowest one, for 5 s and as long as its effects take to settle.

    Args:
        effects: additional ones; 0.05 deg of noise where left out. Its `mismatch` has to be empty, see `devices.names`.
        commands: range of the flexure, the lowest being its rest; all of the device's where left out.
        seed: of noise and friction; equal seeds give the same run after every reset.

    Raises:
        ConfigError: if the sample time is not positive, commands lie beyond the device's, or there is a mismatch.
    """

    def __init__(
        self,
        device: Device,
        effects: Effects | None = None,
        dt_s: float = 0.04,
        commands: Range | None = None,
        seed: int = 0,
    ) -> None:
        if not (np.isfinite(dt_s) and dt_s > 0):
            raise ConfigError(f"dt_s: got {dt_s}, expected a positive number")
        lower, upper = device.commands
        self.command_limits = Range(lower=lower, upper=upper)
        commands, effects = commands or self.command_limits, effects or Effects(noise_deg=0.05)
        if not lower <= commands.lower < commands.upper <= upper:
            raise ConfigError(
                f"limits: got {commands.lower:g} to {commands.upper:g} {device.command_unit}, "
                f"expected within {lower:g} to {upper:g} {device.command_unit}, what the device takes"
            )
        if effects.mismatch:
            raise ConfigError("mismatch: got one for a device that is made already, expected it in `named_device`")
        self._device, self._commands, self._virgin = device, commands, effects.virgin
        sides = {side: tuple(e.operator for e in effects.placed if e.side == side) for side in ("command", "output")}
        self._before = OperatorCascade(stored((*effects.actuator, *sides["command"]), dt_s), dt_s)
        self._after = OperatorCascade(stored(sides["output"], dt_s), dt_s)
        super().__init__(dt_s, commands.lower, device.command_unit, effects.sensing(), seed)

    def _at_rest(self, random: np.random.Generator) -> tuple[float, DeviceState]:
        rest_s = _REST_S + self._before.settling_s + self._after.settling_s
        commands = np.full(round(rest_s / self.dt), self._commands.lower)
        if not self._virgin:
            flexure = s2_initialisation()
            wave = flexure(np.arange(0.0, flexure.duration_s, self.dt))
            span = self._commands.upper - self._commands.lower
            commands = np.concatenate([self._commands.lower + span * wave / wave.max(), commands])
        sent, before = self._before.run(self._before.at_rest(self._commands.lower), commands, settle=True)
        done = self._device.advance(self._device.virgin(), sent, self.dt, random)
        shown, after = self._after.run(self._after.at_rest(float(done.angle[0])), done.angle, settle=True)
        return float(shown[-1]), DeviceState(before, done.state, after)

    def _advanced(self, state: DeviceState, u: float, random: np.random.Generator) -> tuple[float, DeviceState]:
        sent, before = self._before.run(state.command, np.array([u]))
        done = self._device.advance(state.device, sent, self.dt, random)
        shown, after = self._after.run(state.output, done.angle)
        return float(shown[-1]), DeviceState(before, done.state, after)


def make_plant(
    settings: PlantSettings, dt_s: float | None = None, commands: Range | None = None, seed: int = 0
) -> ComputedPlant:
    """Build the plant of a study.

    Args:
        dt_s: sample time [s]; a simulator's own, or 0.04 s, where left out.
        commands: range of flexure and rest; the plant's limits where left out.

    Raises:
        ConfigError: if a mismatch names an unknown parameter, or the commands lie beyond what a device takes.
        ModelError: if a simulator file is missing or unusable, or a mismatch takes a parameter out of its bounds.
    """
    effects = settings.model_dump(exclude={"simulator", "device", "parameters", "inputs"})
    if settings.device is None:
        inputs = {name: partial(one.at, name) for name, one in settings.inputs.items()}
        return SimulatedPlant(load_simulator(_file(settings)), Effects(**effects), dt_s, commands, seed, inputs)
    device = named_device(settings.device, settings.parameters, effects.pop("mismatch"))
    return DevicePlant(device, Effects(**effects), 0.04 if dt_s is None else dt_s, commands, seed)


def plant_files(settings: PlantSettings) -> tuple[Path, ...]:
    """Files from which the plant is read."""
    return (_file(settings),) if settings.device is None else ()


def plant_hash(settings: PlantSettings) -> str:
    """SHA-256 of the simulator file, or of all numbers of the device."""
    if settings.device is None:
        return file_hash(_file(settings))
    numbers = plain_parameters(settings.device, settings.parameters, settings.mismatch)
    return json_hash([settings.device, numbers])


def varied_parameters(settings: PlantSettings) -> tuple[str, ...]:
    """Names of the parameters under `mismatch` that differ between specimens of the plant."""
    if settings.device is None:
        return load_simulator(_file(settings)).chain.labels
    return DEVICES[settings.device].varied


def _file(settings: PlantSettings) -> Path:
    return model_path(str(settings.simulator))

"""The devices by name, with their numbers as settings files give them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, final

import numpy as np

from hystmpc.models.contract.metadata import Range
from hystmpc.trajectories.excitation import s2_initialisation
from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.types import Vec

from ..line import Line
from ..plant import ComputedPlant, Effects, stored
from .device import Device, to_plain
from .muscle import MuscleCatheter, MuscleParameters
from .rod import RodCatheter
from .rod_parameters import RodParameters
from .tendon import TendonCatheter, TendonParameters


@dataclass(frozen=True)
class NamedDevice:
    """One entry of `DEVICES`.

    Attributes:
        make: the device of some parameters.
        parameters: their class.
        varied: those that differ from one specimen to the next, for tunings that are not told what to draw.
    """

    make: Callable[[Any], Device]
    parameters: type[Any]
    varied: tuple[str, ...]


DEVICES: Mapping[str, NamedDevice] = {
    "tendon": NamedDevice(TendonCatheter, TendonParameters, ("friction", "roughness", "viscoelastic")),
    "muscle": NamedDevice(MuscleCatheter, MuscleParameters, ("friction", "slack_bar", "greatest_deg", "half_bar")),
    "rod": NamedDevice(
        RodCatheter,
        RodParameters,
        ("friction", "shaft_drag_n", "rod_drag_n", "stiffness_nmm", "shaft_n_per_mm", "rod_n_per_mm", "set_share"),
    ),
}


class DeviceError(ConfigError):
    """A wrong description of a device.

    Args:
        message: one line.
        at: keys from the description to the offending entry.
    """

    def __init__(self, message: str, at: tuple[str, ...]) -> None:
        super().__init__(message)
        self.at = at


def device_parameters(name: str, parameters: Mapping[str, float], factors: Mapping[str, float]) -> Any:
    """The parameters of a device: its defaults, with `parameters` in their places, times `factors`.

    Raises:
        DeviceError: on an unknown device or parameter, a whole number with a factor or a fraction, or a value out of
            bounds.
    """
    if name not in DEVICES:
        raise DeviceError(f"no device {name!r}, {did_you_mean(name, DEVICES)}", ("device",))
    made = DEVICES[name].parameters()
    known = {f.name: f for f in fields(made)}
    values: dict[str, Any] = {}
    for block, given in (("parameters", parameters), ("mismatch", factors)):
        for key, number in given.items():
            if key not in known:
                raise DeviceError(f"{name} has no parameter {key!r}, {did_you_mean(key, known)}", (block, key))
            number = number if block == "parameters" else values.get(key, getattr(made, key)) * number
            whole = isinstance(getattr(made, key), int)
            if whole and (block == "mismatch" or number != round(number)):
                raise DeviceError(f"{name}.{key}: got {given[key]:g}, expected a whole number, no factor", (block, key))
            values[key] = int(number) if whole else float(number)
            _check_bounds(f"{name}.{key}", values[key], known[key].metadata, (block, key))
    try:
        return replace(made, **values)
    except ConfigError as error:
        raise DeviceError(str(error), ("parameters",)) from None


def named_device(name: str, parameters: Mapping[str, float], factors: Mapping[str, float]) -> Device:
    """A device by name; arguments and errors are those of `device_parameters`.

    Raises:
        DeviceError: as `device_parameters`.
    """
    return DEVICES[name].make(device_parameters(name, parameters, factors))


def parameter_lines(name: str) -> list[str]:
    """One line for each parameter of a device: name, unit, bounds, default, meaning."""
    made = DEVICES[name].parameters()
    lines = []
    for f in fields(made):
        lower, upper = f.metadata["bounds"]
        unit, default = f.metadata["unit"], getattr(made, f.name)
        lines.append(f"{f.name} [{unit}] {lower:g} to {upper:g}, default {default:g}: {f.metadata['meaning']}")
    return lines


def plain_parameters(name: str, parameters: Mapping[str, float], factors: Mapping[str, float]) -> dict[str, Any]:
    """Every number of a device as plain data; arguments and errors are those of `device_parameters`.

    Raises:
        DeviceError: as `device_parameters`.
    """
    return to_plain(device_parameters(name, parameters, factors))


def _check_bounds(where: str, value: float, metadata: Mapping[str, Any], at: tuple[str, ...]) -> None:
    """Raises DeviceError with the value and its bounds."""
    (lower, upper), unit = metadata["bounds"], "" if metadata["unit"] == "1" else f" {metadata['unit']}"
    if not (math.isfinite(value) and lower <= value <= upper):
        raise DeviceError(f"{where} is {value:.6g}{unit}, expected {lower:g} to {upper:g}{unit}", at)


_REST_S = 5.0


@dataclass(frozen=True, eq=False)
class DeviceState:
    """What a device with effects remembers: operators on its command, the device, operators on its angle."""

    command: Vec
    device: Vec
    output: Vec


@final
class DevicePlant(ComputedPlant):
    """A `Device` as a plant, with effects of the library on either side of it.

    Before every run the device does its initialisation flexure (one period of 0.1 Hz over the commands) and rests at
    the lowest one, for 5 s and as long as its effects take to settle.

    Args:
        device: what is controlled.
        effects: what it does beyond that; 0.05 deg of noise where left out. Its numbers are the device's own, so that
            `mismatch` has to be empty; see `names.named_device`.
        dt_s: sample time [s].
        commands: between which it is flexed, the lowest being its rest; all of the device's where left out.
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
        self._before = Line(stored((*effects.actuator, *sides["command"]), dt_s), dt_s)
        self._after = Line(stored(sides["output"], dt_s), dt_s)
        super().__init__(dt_s, commands.lower, device.command_unit, effects.sensing(), seed)

    def _at_rest(self, random: np.random.Generator) -> tuple[float, DeviceState]:
        rest_s = _REST_S + self._before.settling_s + self._after.settling_s
        commands = np.full(round(rest_s / self._dt), self._commands.lower)
        if not self._virgin:
            flexure = s2_initialisation()
            wave = flexure(np.arange(0.0, flexure.duration_s, self._dt))
            span = self._commands.upper - self._commands.lower
            commands = np.concatenate([self._commands.lower + span * wave / wave.max(), commands])
        sent, before = self._before.settle(self._before.at_rest(self._commands.lower), commands)
        done = self._device.advance(self._device.virgin(), sent, self._dt, random)
        shown, after = self._after.settle(self._after.at_rest(float(done.angle[0])), done.angle)
        return float(shown[-1]), DeviceState(before, done.state, after)

    def _advanced(self, state: DeviceState, u: float, random: np.random.Generator) -> tuple[float, DeviceState]:
        sent, before = self._before.run(state.command, np.array([u]))
        done = self._device.advance(state.device, sent, self._dt, random)
        shown, after = self._after.run(state.output, done.angle)
        return float(shown[-1]), DeviceState(before, done.state, after)

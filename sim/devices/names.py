"""Simulated devices by name, with their parameters as settings files give them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.json_text import plain

from .device import Device
from .muscle import MuscleCatheter, MuscleParameters
from .rod import RodCatheter, RodParameters
from .tendon import TendonCatheter, TendonParameters


@dataclass(frozen=True)
class NamedDevice:
    """One entry of `DEVICES`.

    Attributes:
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
    return dict(plain(asdict(device_parameters(name, parameters, factors))))


def _check_bounds(where: str, value: float, metadata: Mapping[str, Any], at: tuple[str, ...]) -> None:
    """Raises DeviceError with the value and its bounds."""
    (lower, upper), unit = metadata["bounds"], "" if metadata["unit"] == "1" else f" {metadata['unit']}"
    if not (math.isfinite(value) and lower <= value <= upper):
        raise DeviceError(f"{where} is {value:.6g}{unit}, expected {lower:g} to {upper:g}{unit}", at)

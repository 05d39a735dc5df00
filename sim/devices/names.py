"""Construction of simulated devices from their names and the parameters in settings files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from typing import Any

from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.from_outside import hint_for, installed_objects
from hystmpc.trials.json_text import plain

from .device import Device, NamedDevice
from .tendon import TendonCatheter, TendonParameters

GROUP = "hystmpc.devices"
"""Entry points by which installed packages add a device; the value is MODULE:NAME of a `NamedDevice`."""

_TENDON = NamedDevice("tendon", TendonCatheter, TendonParameters, ("friction", "roughness", "viscoelastic"))
DEVICES: Mapping[str, NamedDevice] = {
    _TENDON.name: _TENDON,
    **installed_objects(GROUP, "device", NamedDevice, [_TENDON.name]),
}
"""Simulated devices by name, those of installed packages last."""

_OF_THE_LABORATORY = ("muscle", "rod")


class DeviceError(ConfigError):
    """Error in the description of a device; `at` is the path of keys to the wrong entry."""

    def __init__(self, message: str, at: tuple[str, ...]) -> None:
        super().__init__(message)
        self.at = at


def device_parameters(name: str, parameters: Mapping[str, float], factors: Mapping[str, float]) -> Any:
    """Return the parameters of a device: its defaults, replaced by `parameters`, then multiplied by `factors`.

    Raises:
        DeviceError: on an unknown device or parameter, a whole number with a factor or a fraction, or a value out of
            bounds.
    """
    if name not in DEVICES:
        raise DeviceError(f"no device {name!r}, {hint_for(name, DEVICES, _OF_THE_LABORATORY)}", ("device",))
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
            about = known[key].metadata
            (lower, upper), unit = about["bounds"], "" if about["unit"] == "1" else f" {about['unit']}"
            if not (math.isfinite(values[key]) and lower <= values[key] <= upper):
                got = f"{name}.{key} is {values[key]:.6g}{unit}"
                raise DeviceError(f"{got}, expected {lower:g} to {upper:g}{unit}", (block, key))
    try:
        return replace(made, **values)
    except ConfigError as error:
        raise DeviceError(str(error), ("parameters",)) from None


def named_device(name: str, parameters: Mapping[str, float], factors: Mapping[str, float]) -> Device:
    """Build a device by name; arguments are those of `device_parameters`.

    Raises:
        DeviceError: as `device_parameters`.
    """
    numbers = device_parameters(name, parameters, factors)
    return DEVICES[name].make(numbers)


def parameter_lines(name: str) -> list[str]:
    """Return one line for each parameter of a device: name, unit, bounds, default, meaning."""
    made = DEVICES[name].parameters()
    lines = []
    for f in fields(made):
        lower, upper = f.metadata["bounds"]
        unit, default = f.metadata["unit"], getattr(made, f.name)
        lines.append(f"{f.name} [{unit}] {lower:g} to {upper:g}, default {default:g}: {f.metadata['meaning']}")
    return lines


def plain_parameters(name: str, parameters: Mapping[str, float], factors: Mapping[str, float]) -> dict[str, Any]:
    """Return every number of a device as plain data; arguments are those of `device_parameters`.

    Raises:
        DeviceError: as `device_parameters`.
    """
    return dict(plain(asdict(device_parameters(name, parameters, factors))))

"""Interface of simulated devices with explicit state, their parameters, and named devices."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec


@dataclass(frozen=True, eq=False)
class DeviceMotion:
    """Motion of a device under T commands, without any sensor."""

    angle: Vec  # true tip angle at the end of each sample [deg], (T,)
    actuator: Vec  # output of the drive: tendon displacement [mm] or muscle pressure [bar], (T,)
    tension: Vec  # of the tendon [N], (T,); not-a-number where the device has none
    state: Vec  # after the last sample, (S,)


class Device(Protocol):
    """Simulated device whose complete memory is its state (S,)."""

    @property
    def command_unit(self) -> str:
        """Unit of the command: mm or bar."""
        ...

    @property
    def commands(self) -> tuple[float, float]:
        """Least and greatest command of the device."""
        ...

    def virgin(self) -> Vec:
        """Return the state (S,) of a new device: at rest at its least command, never moved before."""
        ...

    def advance(self, state: Vec, commands: Vec, dt_s: float, random: np.random.Generator) -> DeviceMotion:
        """Run commands (T,), each held for `dt_s` [s]; commands beyond the limits are clipped. `state` is unchanged."""
        ...


def quantity(default: float, unit: str, lower: float, upper: float, meaning: str) -> Any:
    """Define a dataclass field with default, unit, inclusive bounds and a line on its meaning."""
    return field(default=default, metadata={"unit": unit, "bounds": (lower, upper), "meaning": meaning})


@dataclass(frozen=True)
class Quantities:
    """Base of parameter blocks: the bounds of every `quantity` are checked.

    Raises:
        ConfigError: naming the block, the parameter, the value and the bounds.
    """

    def __post_init__(self) -> None:
        for f in fields(self):
            if "bounds" in f.metadata:
                value, (lower, upper) = getattr(self, f.name), f.metadata["bounds"]
                if not (math.isfinite(value) and lower <= value <= upper):
                    raise ConfigError(
                        f"{type(self).__name__}.{f.name}: got {value} {f.metadata['unit']}, "
                        f"expected {lower:g} to {upper:g} {f.metadata['unit']}"
                    )


@dataclass(frozen=True)
class NamedDevice:
    """Simulated device that settings files refer to by name."""

    name: str
    make: Callable[[Any], Device]
    parameters: type[Any]
    varied: tuple[str, ...]  # parameters that differ between specimens, which a tuning draws where left out

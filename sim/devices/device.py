"""Interface of simulated devices (explicit state, commands in, motion out), their parameters, and a device by name."""

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
    actuator: Vec  # what the drive reached: tendon displacement [mm] or muscle pressure [bar], (T,)
    tension: Vec  # of the tendon [N], (T,); not-a-number where the device has none
    state: Vec  # after the last sample, (S,)


class Device(Protocol):
    """A device whose whole memory is its state (S,)."""

    @property
    def command_unit(self) -> str:
        """Unit of the command: mm or bar."""
        ...

    @property
    def commands(self) -> tuple[float, float]:
        """Least and greatest command that the device takes."""
        ...

    def virgin(self) -> Vec:
        """State (S,) of a device that rests at its least command and has never been moved."""
        ...

    def advance(self, state: Vec, commands: Vec, dt_s: float, random: np.random.Generator) -> DeviceMotion:
        """Run commands (T,), each held for `dt_s` [s]; commands beyond the limits are clipped. `state` is kept."""
        ...


def quantity(default: float, unit: str, lower: float, upper: float, meaning: str) -> Any:
    """A dataclass field with a default, a unit, inclusive bounds and a line on what it is."""
    return field(default=default, metadata={"unit": unit, "bounds": (lower, upper), "meaning": meaning})


@dataclass(frozen=True)
class Quantities:
    """A block of parameters; every `quantity` in it is compared with its bounds.

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
    """A simulated device that settings files give by its name.

    Attributes:
        make: the device, from its parameters.
        parameters: their class, a block of `Quantities`.
        varied: parameters that differ from one specimen to the next, which a tuning draws where nothing else is said.
    """

    name: str
    make: Callable[[Any], Device]
    parameters: type[Any]
    varied: tuple[str, ...]

"""What a simulated device is to recorders and plants: explicit state, commands in, motion out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hystmpc.trials.types import Vec


@dataclass(frozen=True, eq=False)
class Motion:
    """What a device did under T commands, without any sensor.

    Attributes:
        angle: true tip angle at the end of each sample [deg], (T,).
        actuator: what the drive reached: tendon displacement [mm] or muscle pressure [bar], (T,).
        tension: of the tendon [N], (T,); not-a-number where the device has none.
        state: after the last sample, (S,).
    """

    angle: Vec
    actuator: Vec
    tension: Vec
    state: Vec


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

    def advance(self, state: Vec, commands: Vec, dt_s: float, random: np.random.Generator) -> Motion:
        """Run commands (T,), each held for `dt_s` [s]; commands beyond the limits are clipped. `state` is kept."""
        ...

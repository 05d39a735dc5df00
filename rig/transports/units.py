"""Unit conversion, at the border to the wire and nowhere else."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError

AngleUnit = Literal["deg", "rad"]
CommandUnit = Literal["mm", "m", "bar", "kPa", "Pa"]

_TO_DEG = {"deg": 1.0, "rad": 180.0 / math.pi}
_TO_RUN = {"mm": ("mm", 1.0), "m": ("mm", 1e3), "bar": ("bar", 1.0), "kPa": ("bar", 1e-2), "Pa": ("bar", 1e-5)}


class WireUnits(Settings):
    """Block `wire`: what the device speaks. The angle in degrees is sign * raw + offset_deg, raw taken to degrees."""

    angle_unit: AngleUnit = "deg"
    angle_sign: Literal[1, -1] = 1
    angle_offset_deg: float = 0.0
    command_unit: CommandUnit | None = None


@dataclass(frozen=True)
class Conversion:
    """Raw numbers of the wire to degrees and the run's command unit, and back."""

    angle_factor: float
    angle_offset_deg: float
    command_factor: float

    @classmethod
    def of(cls, wire: WireUnits, command_unit: str) -> Conversion:
        """The conversion between a wire and a run.

        Raises:
            ConfigError: if one speaks of travel and the other of pressure.
        """
        unit, factor = _TO_RUN[wire.command_unit or command_unit]
        if unit != command_unit:
            raise ConfigError(
                f"wire: got command_unit {wire.command_unit}, expected a unit of the run's {command_unit}"
            )
        return cls(wire.angle_sign * _TO_DEG[wire.angle_unit], wire.angle_offset_deg, factor)

    def angle_deg(self, raw: float) -> float:
        """Angle [deg] of a raw one."""
        return self.angle_factor * raw + self.angle_offset_deg

    def raw_angle(self, angle_deg: float) -> float:
        """Raw number of an angle [deg]."""
        return (angle_deg - self.angle_offset_deg) / self.angle_factor

    def command(self, raw: float) -> float:
        """Command in the run's unit of a raw one."""
        return self.command_factor * raw

    def raw_command(self, command: float) -> float:
        """Raw number of a command in the run's unit."""
        return command / self.command_factor

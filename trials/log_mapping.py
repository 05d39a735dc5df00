"""Which signals of a log are time, command and angle, in which units: a mapping file for logs of any layout."""

from __future__ import annotations

import math
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from .config import Settings, load_settings
from .presets import COMMAND_UNITS

COMMAND_UNIT_OF = MappingProxyType(
    {unit: (unit, 1.0) for unit in COMMAND_UNITS}
    | {"um": ("mm", 1e-3), "cm": ("mm", 10.0), "m": ("mm", 1e3)}
    | {"Pa": ("bar", 1e-5), "MPa": ("bar", 10.0), "psi": ("bar", 0.0689475729)}
)
"""Unit that a command may be logged in -> the unit that it is read in, and the factor."""

DEGREES = MappingProxyType({"deg": 1.0, "rad": math.degrees(1.0)})
"""Unit that an angle may be logged in -> degrees."""

SECONDS = MappingProxyType({"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9})
"""Unit of a time signal -> seconds."""

LOG_TIME, HEADER_TIME = "log", "header"
"""Times that every message has: when it was logged, and `header.stamp` of stamped messages."""


class SignalSettings(Settings):
    """One signal: value = scale * (logged - minus) + offset, in `unit`.

    Attributes:
        signal: its name in the log: a column, a MATLAB variable (`run.tip`, `data[1]`), or topic and field
            (`/joints.position[0]`, `/joints.position[tendon]`); indices count from 0.
        minus: a signal of the same time stamps that is taken from it: the second of two opposed chambers or tendons.
        scale, offset: applied to the logged number; the result is in `unit`.
        hold: the value stays until the next one (a command), instead of being interpolated (a measurement).
    """

    signal: Annotated[str, Field(min_length=1)]
    minus: Annotated[str, Field(min_length=1)] | None = None
    scale: float = 1.0
    offset: float = 0.0
    hold: bool = False

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, data: Any) -> Any:
        return {"signal": data} if isinstance(data, str) else data


class CommandSettings(SignalSettings):
    """The command, in one of the units that are read (`m`, `MPa`, ... become mm and bar)."""

    unit: Literal["mm", "um", "cm", "m", "bar", "kPa", "Pa", "MPa", "psi", "V", "A", "N"] = "mm"
    hold: bool = True


class AngleSettings(SignalSettings):
    """The tip angle, in degrees or radians."""

    unit: Literal["deg", "rad"] = "deg"


class LogMapping(Settings):
    """Where a log holds what.

    Attributes:
        command, angle: the two signals that every trial has.
        channels: further signals under the names they get.
        time: a signal that holds time; or `log` (when a message was logged) or `header` (`header.stamp`).
        time_unit: unit of a time signal.
        rate_hz: sampling rate [Hz] of a log without any time; then `time` is not looked at.
        base: the signal whose time stamps the trial gets.
    """

    command: CommandSettings
    angle: AngleSettings
    channels: dict[str, SignalSettings] = Field(default_factory=dict)
    time: Annotated[str, Field(min_length=1)] = LOG_TIME
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: Annotated[float, Field(gt=0)] | None = None
    base: Literal["angle", "command"] = "angle"

    @property
    def name(self) -> str:
        """What messages call this layout."""
        return "mapping"

    def signals(self) -> tuple[SignalSettings, ...]:
        """Command, angle and channels, in this order."""
        return (self.command, self.angle, *self.channels.values())


def is_mapping_file(preset: str) -> bool:
    """Whether what was written after `--preset` names a mapping file."""
    return Path(preset).suffix.lower() in (".yaml", ".yml")


def load_mapping(path: Path | str) -> LogMapping:
    """Read a mapping file.

    Raises:
        ConfigError: if it cannot be read, lacks command or angle, or holds an unknown key or unit; names the line.
    """
    return load_settings(LogMapping, path)

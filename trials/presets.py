"""Layouts of recorded logs: which column is time, which the command, which the tip angle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from .errors import ConfigError, LogError, did_you_mean


@dataclass(frozen=True)
class Preset:
    """One layout of a delimited text log.

    Attributes:
        name: what a user writes after `--preset`.
        summary: one line for help texts.
        time: column of the time stamps [s].
        command: command columns and their units; of these a log holds exactly one, or the first, which wins.
        angle: column of the tip angle [deg].
        channels: readable names of further columns; columns not listed keep the name they have in the log.
        delimiter: what separates the cells.
        columns: column names of a log without a header row, in order; empty where the log has a header row.
        command_range, angle_range: least and greatest plausible value, for the quality check.

    Raises:
        ConfigError: if `columns` lacks the time, the command or the angle.
    """

    name: str
    summary: str
    time: str
    command: Mapping[str, str]
    angle: str
    channels: Mapping[str, str] = field(default_factory=dict)
    delimiter: str = ","
    columns: tuple[str, ...] = ()
    command_range: tuple[float, float] = (-100.0, 100.0)
    angle_range: tuple[float, float] = (-200.0, 200.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "command", MappingProxyType(dict(self.command)))
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))
        if self.columns and (gone := self.missing(self.columns)):
            raise ConfigError(f"preset {self.name}: columns lack {', '.join(gone)}, got {', '.join(self.columns)}")

    @property
    def has_header(self) -> bool:
        """Whether the first row of the log names the columns."""
        return not self.columns

    def missing(self, header: Sequence[str]) -> list[str]:
        """Columns that this layout needs and `header` lacks; alternatives are joined by ` or `."""
        gone = [name for name in (self.time, self.angle) if name not in header]
        if not any(name in header for name in self.command):
            gone.insert(1 if self.time in gone else 0, " or ".join(self.command))
        return gone

    def command_column(self, header: Sequence[str]) -> str:
        """The column of `header` that holds the command.

        Raises:
            LogError: if several columns could be meant.
        """
        found = [name for name in self.command if name in header]
        if len(found) > 1 and found[0] != next(iter(self.command)):
            raise LogError(
                f"several command columns: {', '.join(found)}; expected one, or one named {next(iter(self.command))!r}"
            )
        return found[0]


COMMAND_UNITS = ("mm", "bar", "kPa", "V", "A", "N")
"""Units that a canonical command column may carry in its name; a bare `command` is in the first of them."""

CANONICAL = Preset(
    name="canonical",
    summary="time_s, command (or command_mm, command_bar, ...), angle_deg, any further columns",
    time="time_s",
    command={"command": COMMAND_UNITS[0]} | {f"command_{unit}": unit for unit in COMMAND_UNITS},
    angle="angle_deg",
)

TENDON_CATHETER = Preset(
    name="tendon-catheter",
    summary="EM-tracked tendon catheter, 9 columns (one tendon) or 11 (two): Time, Tendon Disp., ..., Angle z",
    time="Time",
    command={"Tendon Disp.": "mm", "Tendon1 Disp.": "mm"},
    angle="Angle x",
    channels={
        "Tendon2 Disp.": "tendon2_mm",
        "Motor Curr.": "motor_current",
        "Motor1 Curr.": "motor1_current",
        "Motor2 Curr.": "motor2_current",
        "Pos x": "pos_x",
        "Pos y": "pos_y",
        "Pos z": "pos_z",
        "Angle y": "angle_y_deg",
        "Angle z": "angle_z_deg",
    },
    command_range=(-2.0, 20.0),
    angle_range=(-30.0, 200.0),
)

PRESETS: tuple[Preset, ...] = (CANONICAL, TENDON_CATHETER)


def get_preset(name: str) -> Preset:
    """The preset of that name.

    Raises:
        ConfigError: if there is none; names those available and the nearest.
    """
    for preset in PRESETS:
        if preset.name == name:
            return preset
    raise ConfigError(f"unknown preset {name!r}, {did_you_mean(name, ['auto', *(p.name for p in PRESETS)])}")


def detect_preset(header: Sequence[str]) -> Preset:
    """The first preset whose columns are all in `header`.

    Raises:
        LogError: if none fits; lists what each would need and what there is.
    """
    for preset in PRESETS:
        if preset.has_header and not preset.missing(header):
            return preset
    needs = "; ".join(f"{p.name} misses {', '.join(p.missing(header))}" for p in PRESETS if p.has_header)
    raise LogError(f"columns fit no preset: {needs}; available: {', '.join(header)}")

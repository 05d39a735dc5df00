"""Layouts of recorded logs: the columns or signals of time, command and tip angle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from .config import Positive, Settings, load_settings
from .errors import ConfigError, LogError, did_you_mean
from .tip import angles_from_bend, angles_from_tip
from .types import Vec


@dataclass(frozen=True)
class Layout:
    """One layout of a delimited text log.

    A log holds exactly one of the columns `command`, or the first one takes precedence, and one of `angle` and
    `other_angles`.
    """

    name: str  # value of `--layout`
    summary: str  # one line for help texts
    time: str  # column of the time stamps [s]
    command: Mapping[str, str]  # command columns and their units
    angle: str  # column of the tip angle [deg]
    channels: Mapping[str, str] = field(default_factory=dict)  # readable names; other columns keep theirs
    command_range: tuple[float, float] | None = None  # plausible values for the quality check; None for any device
    angle_range: tuple[float, float] | None = None
    other_angles: Mapping[str, str] = field(default_factory=dict)  # columns of an output that is no angle: units

    def known(self) -> tuple[str, ...]:
        """Known names of the columns of time, command and output."""
        return (self.time, self.angle, *self.command, *self.other_angles)

    def spelled(self, header: Sequence[str]) -> tuple[str, ...]:
        """Header in the spelling of this layout, if only capitals or the micro sign differ.

        Names that match exactly remain: capitals distinguish nm from Nm.
        """
        known = frozenset(self.known())
        names = {_folded(name): name for name in known}
        columns, taken = list(header), set(header)
        for k, name in enumerate(header):
            standard = names.get(_folded(name), name)
            if name not in known and standard not in taken:
                columns[k] = standard
                taken.add(standard)
        return tuple(columns)

    def missing(self, header: Sequence[str]) -> list[str]:
        """Required columns that are missing in `header`; alternatives are joined by ` or `."""
        gone = [] if self.time in header else [self.time]
        if not any(name in header for name in (self.angle, *self.other_angles)):
            gone.append(self.angle)
        if not any(name in header for name in self.command):
            first, *others = self.command
            several = len(others) > 1 and all(name.startswith(f"{first}_") for name in others)
            names = f"{first} or {first}_UNIT" if several else " or ".join(self.command)
            gone.insert(1 if self.time in gone else 0, names)
        return gone

    def command_column(self, header: Sequence[str]) -> str:
        """Column of `header` that holds the command.

        Raises:
            LogError: if several columns are possible.
        """
        columns = [name for name in self.command if name in header]
        if len(columns) > 1 and columns[0] != next(iter(self.command)):
            raise LogError(
                f"several command columns: {', '.join(columns)}; "
                f"expected one, or one named {next(iter(self.command))!r}"
            )
        return columns[0]

    def angle_column(self, header: Sequence[str]) -> tuple[str, str]:
        """Column of `header` that holds the angle or another output, and its unit.

        Raises:
            LogError: if several columns are possible.
        """
        columns = [name for name in (self.angle, *self.other_angles) if name in header]
        if len(columns) > 1:
            raise LogError(f"several output columns: {', '.join(columns)}; expected one")
        return columns[0], self.other_angles.get(columns[0], "deg")


_FURTHER = ("nm", "mbar", "mV", "kV", "mA", "mN", "kN", "Nm", "K", "count", "1")

COMMAND_UNITS = ("mm", "bar", "kPa", "V", "A", "N", "deg", "rad", "percent", *_FURTHER)
"""Units in the name of a canonical command column; the first is that of a bare `command`."""

OUTPUT_UNITS = ("mm", "um", "m", "N", "V", "A", "bar", "kPa", "percent", "cm", "Pa", "MPa", "psi", *_FURTHER)
"""Units, in addition to deg, in the name of the canonical column `angle_<unit>`."""

COMMAND_UNIT_OF = MappingProxyType(
    {unit: (unit, 1.0) for unit in COMMAND_UNITS}
    | {"um": ("mm", 1e-3), "cm": ("mm", 10.0), "m": ("mm", 1e3)}
    | {"Pa": ("bar", 1e-5), "MPa": ("bar", 10.0), "psi": ("bar", 0.0689475729)}
)
"""Unit after reading and conversion factor by logged unit of the command; other units remain."""

_MICRO = str.maketrans({"\u00b5": "u", "\u03bc": "u"})  # the micro sign, and the Greek letter that looks like it
_ALIASES = MappingProxyType(
    {"°": "deg", "degree": "deg", "degrees": "deg", "%": "percent", "volt": "V", "volts": "V", "counts": "count"}
    | {"sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "usec": "us", "radians": "rad"}
)


def unit_of(text: str) -> str:
    """Normalised spelling of a unit: `um` for both spellings of micrometres, `deg` for a degree sign."""
    plain = text.strip("[](){}<> ").translate(_MICRO)
    return _ALIASES.get(plain.lower(), plain)


def _folded(name: str) -> str:
    return name.translate(_MICRO).casefold()


CANONICAL = Layout(
    name="canonical",
    summary="time_s, command (or command_mm, command_bar, ...), angle_deg (or angle_mm, ...), any further columns",
    time="time_s",
    command={"command": COMMAND_UNITS[0]} | {f"command_{unit}": unit for unit in (*COMMAND_UNITS, *COMMAND_UNIT_OF)},
    angle="angle_deg",
    other_angles={f"angle_{unit}": unit for unit in OUTPUT_UNITS},
)

OUTPUT_COLUMN = MappingProxyType({"deg": CANONICAL.angle} | {u: name for name, u in CANONICAL.other_angles.items()})
"""Canonical column by unit of an output."""


def command_column(unit: str) -> str:
    """Canonical column of a command in one of `COMMAND_UNITS`."""
    return "command" if unit == COMMAND_UNITS[0] else f"command_{unit}"


TENDON_CATHETER = Layout(
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

TWO_AXES = Layout(
    name="two-axes",
    summary="two bending axes: time_s, command_x, command_y (or command_x_bar, ...), angle_x_deg, angle_y_deg",
    time="time_s",
    command={"command_x": COMMAND_UNITS[0]} | {f"command_x_{unit}": unit for unit in COMMAND_UNITS},
    angle="angle_x_deg",
)

TENDONS = Layout(
    name="tendons",
    summary="two bending axes, three and more tendons: time_s, command_1 (or command_1_bar, ...), command_2, ..., "
    "angle_x_deg, angle_y_deg",
    time="time_s",
    command={"command_1": COMMAND_UNITS[0]} | {f"command_1_{unit}": unit for unit in COMMAND_UNITS},
    angle="angle_x_deg",
)

ANGLE_Y = "angle_y_deg"
"""Channel of the second angle of a log of two axes."""

LAYOUTS: tuple[Layout, ...] = (CANONICAL, TWO_AXES, TENDONS, TENDON_CATHETER)


def layout_named(name: str) -> Layout:
    """Return the layout with a given name.

    Raises:
        ConfigError: if there is none; names those available and the nearest.
    """
    for layout in LAYOUTS:
        if layout.name == name:
            return layout
    raise ConfigError(f"unknown layout {name!r}, {did_you_mean(name, ['auto', *(p.name for p in LAYOUTS)])}")


def detect_layout(header: Sequence[str]) -> Layout:
    """First layout whose columns are all in `header`.

    Raises:
        LogError: if none fits; lists the required and the existing columns.
    """
    for layout in LAYOUTS:
        if not layout.missing(layout.spelled(header)):
            return layout
    nearest = min(LAYOUTS, key=lambda p: len(p.missing(p.spelled(header))))
    gone = ", ".join(nearest.missing(nearest.spelled(header)))
    raise LogError(f"columns fit no layout: {nearest.name} misses {gone}; available: {few(header, 50)}")


def few(names: Iterable[str], longest: int = 60) -> str:
    """First names of a list, up to `longest` characters, for an error line."""
    kept: list[str] = []
    every = [name for name in names if name]
    for name in every:
        if kept and len(", ".join([*kept, name])) > longest:
            break
        kept.append(name if len(name) <= longest else f"{name[: longest - 4]} ...")
    return ", ".join(kept) + (f", ... ({len(every)} in all)" if len(kept) < len(every) else "") or "none"


MAPPING_HINT = (
    "; or map the names: `{time: NAME, command: {signal: NAME, unit: mm}, angle: {signal: NAME, unit: deg}}` "
    "in map.yaml, `--layout map.yaml`"
)
"""End of an error line on columns that fit no layout."""


ANGLE_UNIT_OF = MappingProxyType({"rad": ("deg", math.degrees(1.0))})
"""Unit after reading and conversion factor by logged unit of the output; other units remain."""

UnitName = Literal[
    "deg", "rad", "mm", "um", "nm", "cm", "m", "bar", "mbar", "kPa", "Pa", "MPa", "psi", "V", "mV", "kV", "A", "mA",
    "N", "mN", "kN", "Nm", "K", "percent", "count", "1",
]  # fmt: skip
"""Units allowed in a mapping, as a list to detect spelling errors; `1` is for all others."""

LOG_TIME, HEADER_TIME = "log", "header"
"""Time stamps of every message: time of logging, and `header.stamp` of stamped messages."""


class SignalSettings(Settings):
    """One signal: value = scale * (logged - minus + plus) + offset, in `unit`.

    Attributes:
        signal: its name in the log: a column, a MATLAB variable (`run.tip`, `data[1]`), or topic and field
            (`/joints.position[0]`, `/joints.position[tendon]`); indices count from 0.
        minus: a signal of the same time stamps that is taken from it: the second of two opposed chambers or tendons.
        plus: one that is added to it instead: the sum of such a pair is its co-contraction.
        scale, offset: applied to the logged number; the result is in `unit`.
        hold: the value stays until the next one (a command), instead of being interpolated (a measurement).
        missing: logged numbers, such as -9999, that stand for no value; these samples are left out.
        sign_bit: bit of the logged number that is its sign, the lower bits its size, such as 15 of a servo.
        wraps_at: modulus of the logged number, such as 360 or 65536; its jumps are taken out, and it begins within
            half of this of zero.
        shift_s: added to the time stamps of this signal [s], where it has another clock.
    """

    signal: Annotated[str, Field(min_length=1)]
    minus: Annotated[str, Field(min_length=1)] | None = None
    plus: Annotated[str, Field(min_length=1)] | None = None
    scale: float = 1.0
    offset: float = 0.0
    hold: bool = False
    missing: tuple[float, ...] = ()
    sign_bit: Annotated[int, Field(ge=1, le=62)] | None = None
    wraps_at: Positive | None = None
    shift_s: float = 0.0

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("unit"), str):
            return data | {"unit": unit_of(data["unit"])}
        return {"signal": data} if isinstance(data, str) else data

    @model_validator(mode="after")
    def _difference_or_sum(self) -> Self:
        if self.minus is not None and self.plus is not None:
            raise ValueError(f"got minus {self.minus!r} and plus {self.plus!r}, expected one of them")
        return self

    @property
    def second(self) -> str | None:
        """The signal that is taken from this one, or added to it."""
        return self.minus or self.plus

    @classmethod
    def __get_pydantic_json_schema__(cls, core: Any, handler: Any) -> dict[str, Any]:
        """JSON schema that accepts a block of keys or the bare name of a signal."""
        return {"anyOf": [{"type": "string", "minLength": 1}, dict(handler.resolve_ref_schema(handler(core)))]}


class CommandSettings(SignalSettings):
    """The command; of `COMMAND_UNIT_OF`, lengths become mm and pressures bar, which benches send.

    Attributes:
        unit: unit of the result of scale and offset.
    """

    unit: UnitName = "mm"
    hold: bool = True


class AngleSettings(SignalSettings):
    """The tip angle or another output, such as a displacement or force; rad become deg, all else keeps its unit.

    Attributes:
        unit: unit of the result of scale and offset.
    """

    unit: UnitName = "deg"


class InputSettings(SignalSettings):
    """A measured input: a signal, or one number for a whole log that was recorded at a constant value.

    Attributes:
        value: the number; a number alone in place of the block says the same.
        by_file: the number of each log, by the pattern of its file's name: `{"*_1bar.tsv": 1.0}`.
    """

    signal: str = ""
    value: float | None = None
    by_file: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _number_alone(cls, data: Any) -> Any:
        return {"value": data} if isinstance(data, int | float) and not isinstance(data, bool) else data

    @model_validator(mode="after")
    def _one_source(self) -> InputSettings:
        if (self.signal != "") + (self.value is not None) + bool(self.by_file) != 1:
            raise ValueError("expected one of `signal: NAME`, `value: NUMBER` and `by_file: {PATTERN: NUMBER}`")
        if self.value is not None and not math.isfinite(self.value):
            raise ValueError(f"value is {self.value}, expected a finite number")
        return self

    def number(self, path: str) -> float | None:
        """The constant value for a log, None where it is a signal.

        Raises:
            LogError: if no pattern, or several, fit the name of the file.
        """
        if not self.by_file:
            return self.value
        fitting = [value for pattern, value in self.by_file.items() if fnmatch(Path(path).name, pattern)]
        if len(fitting) != 1:
            raise LogError(f"{path}: {len(fitting)} patterns of `by_file` fit, expected one of {few(self.by_file)}")
        return fitting[0]


class TipSignals(Settings):
    """Two bending angles by the tip of a bend of constant curvature: a bend and its plane, or a position.

    Attributes:
        bend: angle between base and tip [deg or rad].
        plane: direction of the bend around the base, from x to y [deg or rad]; it wraps at a turn.
        x, y, z: position of the tip in one unit of length, seen from the base of the bending part, which is straight
            along z; `offset` moves the origin there.
    """

    bend: AngleSettings | None = None
    plane: AngleSettings | None = None
    x: SignalSettings | None = None
    y: SignalSettings | None = None
    z: SignalSettings | None = None

    @model_validator(mode="after")
    def _bend_or_position(self) -> TipSignals:
        given = {name for name in ("bend", "plane", "x", "y", "z") if getattr(self, name) is not None}
        if given not in ({"bend", "plane"}, {"x", "y", "z"}):
            raise ValueError(f"got {', '.join(sorted(given)) or 'nothing'}, expected bend and plane, or x, y and z")
        angles = [one.unit for one in (self.bend, self.plane) if one is not None]
        if any(unit not in _TURNS for unit in angles):
            raise ValueError(f"got {' and '.join(angles)}, expected bend and plane in deg or rad")
        return self

    def signals(self) -> tuple[SignalSettings, ...]:
        """Bend and plane, or x, y and z."""
        plane = self.plane
        if plane is not None and plane.wraps_at is None and plane.scale == 1.0:
            plane = plane.model_copy(update={"wraps_at": _TURNS[plane.unit]})
        return tuple(one for one in (self.bend, plane, self.x, self.y, self.z) if one is not None)

    def angles(self, values: Sequence[Vec]) -> Vec:
        """Bending angles (T, 2) [deg] of the signals' values (T,).

        Raises:
            LogError: if a tip is behind its base.
        """
        if self.bend is None or self.plane is None:
            return angles_from_tip(np.stack(values, axis=-1))
        bend, plane = (360 / _TURNS[one.unit] * v for one, v in zip((self.bend, self.plane), values, strict=True))
        return angles_from_bend(bend, plane)


_TURNS = {"deg": 360.0, "rad": 2 * math.pi}


def _angle_or_tip(schema: dict[str, Any]) -> None:
    schema["required"] = [name for name in schema["required"] if name != "angle"]
    schema["oneOf"] = [{"required": ["angle"]}, {"required": ["tip"]}]


class LogMapping(Settings):
    """Mapping of the signals of a log to time, command, angle, channels and measured inputs.

    Attributes:
        command, angle: the two signals that every trial has.
        tip: in place of the angle, signals of the tip that give two bending angles.
        channels: further signals under the names they get.
        inputs: measured signals on which the device depends, such as a pressure, under the names they get.
        time: a signal that holds time; or `log` (when a message was logged) or `header` (`header.stamp`).
        time_unit: unit of a time signal; `d` are days, as spreadsheets have them.
        time_wraps_at: modulus of a time signal that is a counter, in its unit, such as 65536 or 4294967296.
        rate_hz: sampling rate [Hz] of a log without any time, or with a broken clock; then `time` is not looked at.
        base: the signal whose time stamps the trial gets.
    """

    model_config = ConfigDict(json_schema_extra=_angle_or_tip)

    command: CommandSettings
    angle: AngleSettings
    tip: TipSignals | None = None
    channels: dict[str, SignalSettings] = Field(default_factory=dict)
    inputs: dict[str, InputSettings] = Field(default_factory=dict)
    time: Annotated[str, Field(min_length=1)] = LOG_TIME
    time_unit: Literal["s", "ms", "us", "ns", "min", "h", "d"] = "s"
    time_wraps_at: Positive | None = None
    rate_hz: Positive | None = None
    base: Literal["angle", "command"] = "angle"

    @model_validator(mode="before")
    @classmethod
    def _angle_of_tip(cls, data: Any) -> Any:
        """The first signal of a tip is that of the angle, whose time stamps count."""
        if not isinstance(data, Mapping) or data.get("tip") is None:
            return data
        if "angle" in data:
            raise ValueError("got angle and tip, expected one of them")
        tip = data["tip"] if isinstance(data["tip"], Mapping) else {}
        first = tip.get("bend") or tip.get("x") or "tip"
        return {**data, "angle": first if "bend" in tip else _in_mm(first)}

    @property
    def name(self) -> str:
        """Name of this layout in messages."""
        return "mapping"

    def signals(self) -> tuple[SignalSettings, ...]:
        """Command, angle, channels, the inputs that are signals, and those of the tip behind its first."""
        further = () if self.tip is None else self.tip.signals()[1:]
        inputs = (one for one in self.inputs.values() if one.signal)
        return (self.command, self.angle, *self.channels.values(), *inputs, *further)


def _in_mm(signal: Any) -> Any:
    return {**signal, "unit": "mm"} if isinstance(signal, Mapping) else {"signal": signal, "unit": "mm"}


def is_mapping_file(layout: str) -> bool:
    """Whether the value of `--layout` is the name of a mapping file."""
    return Path(layout).suffix.lower() in (".yaml", ".yml")


def load_mapping(path: Path | str) -> LogMapping:
    """Read a mapping file.

    Raises:
        ConfigError: if it cannot be read, lacks command or angle, or holds an unknown key or unit; names the line.
    """
    return load_settings(LogMapping, path)

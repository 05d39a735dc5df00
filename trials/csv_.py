"""Trials from and to comma-separated files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import LogError
from .files import write_atomically
from .presets import CANONICAL, COMMAND_UNITS, Preset, detect_preset, get_preset
from .table import Table, first_row, format_table, read_lines, read_table
from .trial import Trial, Units
from .types import Vec


@dataclass(frozen=True, eq=False)
class Columns:
    """A log as it was written: numbers, but not yet checked to be finite or in order.

    Attributes:
        t, command, angle: time [s], command and tip angle [deg], each (T,).
        channels: further columns under their readable names, each (T,).
        units: units of command and angle.
        preset: the layout that was read.
        table: the text behind it, to name rows in messages.
        names: columns of the log behind `t`, `command` and `angle`.
    """

    t: Vec
    command: Vec
    angle: Vec
    channels: Mapping[str, Vec]
    units: Units
    preset: Preset
    table: Table
    names: Mapping[str, str]

    @property
    def source(self) -> str:
        """Path of the log."""
        return self.table.source

    def row(self, sample: int) -> int:
        """Row of a sample, 1-based as an editor shows it."""
        return self.table.locate(sample, self.names["t"])[0]


def read_columns(path: Path | str, preset: str | Preset = "auto") -> Columns:
    """Read a log without judging its values: empty cells are not-a-number, time may repeat.

    Columns of text are left out; `Columns.table.texts` holds them.

    Raises:
        LogError: if the file cannot be read as a table or lacks a column; names file, row and column.
        ConfigError: on an unknown preset.
    """
    layout = get_preset(preset) if isinstance(preset, str) and preset != "auto" else preset
    lines = read_lines(path)
    if isinstance(layout, str):
        layout = _detect(lines, str(path))
    table = read_table(lines, str(path), layout.delimiter, layout.columns)
    if gone := layout.missing(table.header):
        raise LogError(
            f"{path}: missing columns for preset {layout.name}: {', '.join(gone)}; "
            f"available: {', '.join(table.header)}{_header_hint(table.header)}"
        )
    try:
        command = layout.command_column(table.header)
    except LogError as error:
        raise LogError(f"{path}: {error}") from None
    names = {"t": layout.time, "command": command, "angle": layout.angle}
    for name in names.values():
        if name in table.texts:
            row, cell = table.locate(0, name)
            raise LogError(f"{path}, row {row}, column {name!r}: got {cell!r}, expected a number")
    others = [k for k in table.numbers if k and k not in names.values()]  # a trailing comma makes a nameless column
    channels = {layout.channels.get(k, k): table.numbers[k] for k in others}
    t, u, angle = (table.numbers[name] for name in names.values())
    return Columns(t, u, angle, channels, Units(command=layout.command[command]), layout, table, names)


def read_csv(path: Path | str, preset: str | Preset = "auto") -> Trial:
    """Read one trial.

    Time, command and angle must be finite and time must increase; further columns may hold empty cells (read as
    not-a-number), and columns of text are left out.

    Args:
        path: the log.
        preset: its layout: a name, a `Preset`, or `auto` to tell it from the header.

    Raises:
        LogError: on anything else; one line with file, row, column, what was got and what was expected.
        ConfigError: on an unknown preset.
    """
    columns = read_columns(path, preset)
    for name, values in (("t", columns.t), ("command", columns.command), ("angle", columns.angle)):
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            row, cell = columns.table.locate(int(bad[0]), columns.names[name])
            more = f" ({bad.size} such cells)" if bad.size > 1 else ""
            got = repr(cell) if cell else "an empty cell"
            raise LogError(
                f"{path}, row {row}, column {columns.names[name]!r}: got {got}, expected a finite number{more}"
            )
    late = np.flatnonzero(np.diff(columns.t) <= 0)
    if late.size:
        k = int(late[0])
        raise LogError(
            f"{path}, row {columns.row(k + 1)}, column {columns.names['t']!r}: got {columns.t[k + 1]:.9g} s after "
            f"{columns.t[k]:.9g} s, expected increasing time ({late.size} such rows)"
        )
    return Trial(columns.t, columns.command, columns.angle, columns.channels, columns.units, str(path))


def write_csv(trial: Trial, path: Path | str) -> Path:
    """Write a trial in canonical columns, whole or not at all; it reads back exactly.

    A command in mm is written as `command`, in another unit as `command_<unit>`.

    Raises:
        LogError: if a channel has the name of a canonical column, or a unit cannot be named in the header.
    """
    unit = trial.units.command
    if unit not in COMMAND_UNITS or trial.units.angle != "deg":
        raise LogError(
            f"{trial.source}: units are {unit} and {trial.units.angle}, "
            f"expected a command in {', '.join(COMMAND_UNITS)} and an angle in deg"
        )
    reserved = {CANONICAL.time, CANONICAL.angle, *CANONICAL.command}
    if clash := sorted(reserved & set(trial.channels)):
        raise LogError(f"{trial.source}: channel {clash[0]!r} has the name of a canonical column, expected another")
    command = "command" if unit == COMMAND_UNITS[0] else f"command_{unit}"
    columns = {CANONICAL.time: trial.t, command: trial.command, CANONICAL.angle: trial.angle, **trial.channels}
    return write_atomically(path, format_table(columns))


def expand_logs(paths: Iterable[Path | str]) -> list[Path]:
    """Logs to read: a folder stands for its `*.csv`, or else its logs of other formats, in the order of their names.

    Raises:
        LogError: if nothing is given, or a folder holds no log.
    """
    from .read import logs_in  # the readers of all formats build on this module

    files: list[Path] = []
    for path in map(Path, paths):
        inside = logs_in(path) if path.is_dir() else [path]
        if not inside:
            raise LogError(f"{path}: no *.csv (nor *.mcap, *.db3, *.mat) in this folder, expected recorded logs")
        files += inside
    if not files:
        raise LogError("no logs given, expected files or folders of logs")
    return files


def read_trials(paths: Iterable[Path | str], preset: str | Preset = "auto") -> list[Trial]:
    """Read several trials of any format; see `expand_logs` for folders and `read_log` for formats and presets.

    Raises:
        LogError: if nothing is found, or a log cannot be read.
        ConfigError: on an unknown preset or a wrong mapping file.
    """
    from .read import read_all

    return read_all(expand_logs(paths), preset)


def _detect(lines: Sequence[str], source: str) -> Preset:
    """Layout told from the header row."""
    index, header = first_row(lines, CANONICAL.delimiter)
    try:
        return detect_preset(header)
    except LogError as error:
        raise LogError(f"{source}, row {index + 1}: {error}{_header_hint(header)}") from None


def _header_hint(header: Sequence[str]) -> str:
    """What to add where the first row does not look like a row of column names."""
    if len(header) > 1:
        numbers = all(cell.lstrip("+-")[:1].isdigit() for cell in header)
        return " (the first row holds numbers, expected column names)" if numbers else ""
    separators = ((";", "semicolons"), ("\t", "tabs"), (" ", "spaces"))
    found = next((name for sign, name in separators if sign in header[0]), "")
    return f" (cells seem to be separated by {found}, expected commas)" if found else ""

"""Reading a log of any format: the ending of its name, or the folder, tells which."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .csv_files import Table, first_row, read_csv, read_lines, read_table
from .errors import ConfigError, LogError
from .layouts import (
    LogMapping,
    Preset,
    get_preset,
    is_mapping_file,
    load_mapping,
)
from .mat_ import open_mat
from .mcap_ import open_mcap
from .rosbag_ import is_bag, open_bag
from .signals import Raw, Series, Source, canonical_mapping, missing, read_mapped
from .trial import Trial

Layout = str | Preset | LogMapping

OPENERS: dict[str, Callable[[Path], Source]] = {".mcap": open_mcap, ".db3": open_bag, ".mat": open_mat}
"""Formats of named signals by the ending of the file; every other ending is delimited text."""


def read_log(path: Path | str, preset: Layout = "auto") -> Trial:
    """Read one trial from delimited text, MCAP, a ROS 2 bag or a MATLAB file.

    Args:
        path: a file, or the folder of a ROS 2 bag.
        preset: layout: a name, a mapping file (`*.yaml`), a `Preset` (delimited text), a `LogMapping`, or `auto`.

    Raises:
        LogError: if the log cannot be used; one line with the file, what was got and what is available.
        ConfigError: on an unknown preset or a wrong mapping file, or a preset of another format.
    """
    layout = resolve(preset)
    if is_text(path) and not isinstance(layout, LogMapping):
        return read_csv(path, layout)
    return read_raw(path, layout).trial()


def read_raw(path: Path | str, preset: Layout = "auto") -> Raw:
    """Read a log by its named signals without judging its values.

    Raises:
        LogError: if the log cannot be read, or lacks a signal.
        ConfigError: on an unknown preset or a wrong mapping file, or a preset of another format.
    """
    place, layout = Path(path), resolve(preset)
    source = _open(place)
    if isinstance(layout, LogMapping):
        return read_mapped(source, layout)
    if layout != "auto":
        name = layout.name if isinstance(layout, Preset) else layout
        if name != "canonical":
            raise ConfigError(f"{path}: preset {name} is for delimited text, expected auto or a mapping file (*.yaml)")
    return read_mapped(source, canonical_mapping(source.names(), source.path))


def resolve(preset: Layout) -> Layout:
    """What `--preset` means: a mapping is read from its file; a name is checked.

    Raises:
        ConfigError: on an unknown preset or a wrong mapping file.
    """
    if not isinstance(preset, str) or preset == "auto":
        return preset
    return load_mapping(preset) if is_mapping_file(preset) else get_preset(preset)


def is_text(path: Path | str) -> bool:
    """Whether a log is delimited text."""
    place = Path(path)
    return place.suffix.lower() not in OPENERS and not is_bag(place)


def logs_in(folder: Path) -> list[Path]:
    """What a folder stands for: its `*.csv`; without any, its bags, `*.mcap`, `*.db3` and `*.mat`, by name."""
    if is_bag(folder):
        return [folder]
    tables = sorted(folder.glob("*.csv"))
    others = [entry for entry in folder.iterdir() if is_bag(entry) or entry.suffix.lower() in OPENERS]
    return tables or sorted(others)


def read_all(paths: Iterable[Path], preset: Layout = "auto") -> list[Trial]:
    """Read several trials of one layout.

    Raises:
        LogError: if a log cannot be read.
        ConfigError: on an unknown preset or a wrong mapping file.
    """
    layout = resolve(preset)
    return [read_log(path, layout) for path in paths]


def _open(path: Path) -> Source:
    if is_bag(path):
        return open_bag(path)
    opener = OPENERS.get(path.suffix.lower())
    return opener(path) if opener is not None else _TableLog(path)


class _TableLog:
    """A `Source` over delimited text, for mapping files; columns without a header row are `[0]`, `[1]`, ..."""

    note = ""

    def __init__(self, path: Path) -> None:
        self.path = str(path)
        lines = read_lines(path)
        _, cells = first_row(lines, ",")
        delimiter = next((sign for sign in ";\t" if len(cells) == 1 and sign in cells[0]), ",")
        if delimiter == "," and len(cells) == 1 and " " in cells[0]:
            lines = [",".join(line.split()) for line in lines]
        _, cells = first_row(lines, delimiter)
        unnamed = [f"[{k}]" for k in range(len(cells))] if all(map(_is_number, cells)) else []
        self._table: Table = read_table(lines, self.path, delimiter, unnamed)

    def names(self) -> tuple[str, ...]:
        return tuple(name for name in self._table.numbers if name)

    def series(self, signals: Iterable[str], time: str) -> list[Series]:
        t = self._column(time) if time not in ("log", "header") else None
        columns = [self._column(signal) for signal in signals]
        return [Series(np.full(y.size, np.nan) if t is None else t, y) for y in columns]

    def _column(self, name: str) -> NDArray[np.float64]:
        if name not in self._table.numbers:
            raise missing(self.path, name, self.names())
        return self._table.numbers[name]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


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

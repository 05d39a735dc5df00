"""The table of a sweep on disk: shards while it runs, one file afterwards; no row lost or counted twice."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, final

import numpy as np

from hystmpc.trials.errors import ConfigError, LogError

from . import csv_rows
from .csv_rows import Column, chosen

_NAME = "runs"
_SHARDS = "shards"
_EVERY_S = 5.0
_BUFFERED = 500


def format_of(folder: Path) -> ModuleType:
    """Parquet or CSV: what the folder has, else Parquet where pyarrow is installed.

    Raises:
        ConfigError: if the folder has Parquet and pyarrow is missing.
    """
    held = {path.suffix for path in files_of(folder)}
    wanted = ".parquet" in held or (csv_rows.ENDING not in held and find_spec("pyarrow") is not None)
    if not wanted:
        return csv_rows
    try:
        from . import parquet_
    except ModuleNotFoundError:
        raise ConfigError(
            f"{folder}: its table is Parquet, expected pyarrow installed: pip install 'hystmpc[tune]'"
        ) from None
    return parquet_


def files_of(folder: Path) -> list[Path]:
    """Files of a table, oldest first: the whole one, then the shards."""
    whole = [path for ending in (".parquet", ".csv") if (path := folder / f"{_NAME}{ending}").exists()]
    shards = [path for path in (folder / _SHARDS).glob("*") if path.suffix in (".parquet", ".csv")]
    return whole + sorted(path for path in shards if not path.name.startswith("."))


def table_of(folder: Path, names: Iterable[str]) -> dict[str, Column]:
    """Columns (N,) of a table, every row once; a row that was done again counts as it came out last.

    Raises:
        ConfigError: if pyarrow is needed and missing.
        LogError: if a file is damaged.
    """
    names, tables = list(names), []
    form = format_of(folder)
    for path, rows in _lasting(folder, form).items():
        part = _read(form, path, names)
        mask = np.zeros(len(part[names[0]]), dtype=bool)
        mask[rows] = True
        tables.append(chosen(part, mask))
    return {name: _joined([table[name] for table in tables]) for name in names}


def _joined(parts: list[Column]) -> Column:
    if parts and all(isinstance(part, np.ndarray) for part in parts):
        return np.concatenate([np.asarray(part) for part in parts])
    return [None if value is None else str(value) for part in parts for value in part]


def _lasting(folder: Path, form: ModuleType) -> dict[Path, list[int]]:
    """The rows of every file that count: of an id the last that was done, else the last."""
    where: dict[str, tuple[Path, int, bool]] = {}
    for path in files_of(folder):
        part = _read(form, path, ["id", "status"])
        for k, (identity, status) in enumerate(zip(part["id"], part["status"], strict=True)):
            done = status == "done"
            if done or not where.get(str(identity), (path, k, False))[2]:
                where[str(identity)] = (path, k, done)
    found: dict[Path, list[int]] = {}
    for path, k, _ in where.values():
        found.setdefault(path, []).append(k)
    return {path: sorted(found[path]) for path in files_of(folder) if path in found}


def _read(form: ModuleType, path: Path, names: Iterable[str]) -> dict[str, Column]:
    try:
        columns: dict[str, Column] = form.read(path, names)
    except (OSError, ValueError, IndexError, KeyError) as error:  # pyarrow's errors are ValueErrors
        raise LogError(f"{path}: not a table of runs ({error}); remove it to have its rows done again") from None
    return columns


@final
class Store:
    """Takes rows; what it took is on disk five seconds later at the latest row."""

    def __init__(self, folder: Path, kinds: Mapping[str, str]) -> None:
        self._folder, self._kinds = folder, dict(kinds)
        self._form = format_of(folder)
        self._rows: list[Mapping[str, Any]] = []
        self._saved = time.monotonic()

    def done(self) -> set[str]:
        """Rows that need not be done again.

        Raises:
            LogError: if a file is damaged.
        """
        table = table_of(self._folder, ["id", "status"])
        return {str(i) for i, status in zip(table["id"], table["status"], strict=True) if status == "done"}

    def add(self, row: Mapping[str, Any]) -> None:
        """Take a row."""
        self._rows.append(row)
        if len(self._rows) >= _BUFFERED or time.monotonic() - self._saved > _EVERY_S:
            self.flush()

    def flush(self) -> None:
        """Write what was taken as a shard, whole or not at all."""
        self._saved = time.monotonic()
        if not self._rows:
            return
        shards = self._folder / _SHARDS
        shards.mkdir(parents=True, exist_ok=True)
        name = f"{time.time_ns():020d}-{os.getpid()}{self._form.ENDING}"
        half = shards / f".{name}"
        self._form.write(half, self._rows, self._kinds)
        os.replace(half, shards / name)
        self._rows = []

    def merge(self) -> Path | None:
        """Make one file of all; a process that dies on the way leaves rows twice at most, which readers count once.

        Raises:
            LogError: if a file is damaged.
        """
        self.flush()
        files = files_of(self._folder)
        target = self._folder / f"{_NAME}{self._form.ENDING}"
        if not files or files == [target]:
            return target if files else None
        kinds: dict[str, str] = {}
        for path in files:
            for name, kind in self._form.kinds(path).items():
                kinds[name] = kind if kinds.get(name, kind) == kind else "text"
        self._form.merge(target, list(_lasting(self._folder, self._form).items()), kinds)
        for path in files:
            if path != target:
                path.unlink()
        for half in (self._folder / _SHARDS).glob(".*"):
            half.unlink()  # of a process that was killed while it wrote
        return target

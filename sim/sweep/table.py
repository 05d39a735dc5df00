"""Table of a sweep: a row for each run in one SQLite file, with a readable copy as CSV.

Only the process that collects results writes rows. Several such processes on one machine wait for each other.
"""

from __future__ import annotations

import csv
import json
import math
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, final

import numpy as np

from hystmpc.trials.errors import LogError
from hystmpc.trials.json_text import plain
from hystmpc.trials.types import Vec

Column = Vec | list[str | None]
TABLE = "runs.db"
COPY = "runs.csv"
_CREATE = "CREATE TABLE IF NOT EXISTS runs (id TEXT PRIMARY KEY, status TEXT, settings TEXT, figures TEXT)"
_PUT = """INSERT INTO runs VALUES (?, ?, ?, ?) ON CONFLICT (id) DO UPDATE
SET status = excluded.status, settings = excluded.settings, figures = excluded.figures
WHERE excluded.status = 'done' OR runs.status <> 'done'"""
_NOT_COPIED = ("settings", "files")  # for repetition of a run only
_BUSY_S = 60.0  # wait for another process's writing
_PAUSE = 10.0  # time between two writes over the duration of one: writing takes at most a tenth of the time


@final
class RunTable:
    """Rows by `id` in one SQLite file, written atomically; the last successful run of a row is stored.

    `folder` is that of the sweep; the file is created where it is missing.

    Raises:
        LogError: if the file is damaged or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._rows: list[tuple[str, str, str, str]] = []
        self._written, self._cost_s = -math.inf, 0.0
        with _opened(folder) as base:
            base.execute(_CREATE)

    def done(self) -> set[str]:
        """Return the ids of the rows that need no repetition."""
        with _opened(self._folder) as base:
            return {identity for (identity,) in base.execute("SELECT id FROM runs WHERE status = 'done'")}

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row: `id`, `status`, `settings` (JSON), and values that are numbers, texts or None."""
        figures = plain({name: value for name, value in row.items() if name not in ("id", "status", "settings")})
        self._rows.append((row["id"], row["status"], row.get("settings", ""), json.dumps(figures)))
        if time.monotonic() - self._written >= _PAUSE * self._cost_s:
            self.flush()

    def flush(self) -> None:
        """Write the added rows, all or none of them."""
        start = time.monotonic()
        with _opened(self._folder) as base:
            base.executemany(_PUT, self._rows)
        self._rows = []
        self._written = time.monotonic()
        self._cost_s = self._written - start

    def copy(self, names: Iterable[str]) -> Path | None:
        """Write all rows as CSV atomically, without the settings, first the columns `names`; None without a row."""
        self.flush()
        columns = dict.fromkeys(name for name in names if name not in _NOT_COPIED)
        count = 0
        for row in rows_of(self._folder):
            columns.update(dict.fromkeys(name for name in row if name not in _NOT_COPIED))
            count += 1
        if not count:
            return None
        half, target = self._folder / f".{COPY}.part", self._folder / COPY
        with half.open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, list(columns), extrasaction="ignore", lineterminator="\n")
            table.writeheader()
            table.writerows(rows_of(self._folder))
            file.flush()
            os.fsync(file.fileno())
        os.replace(half, target)
        return target


def rows_of(folder: Path, prefix: str = "", *, settings: bool = False) -> Iterator[dict[str, Any]]:
    """Rows of a table in the order in which they were added; none without a table.

    Args:
        prefix: first digits of their ids.
        settings: whether to read the settings too, which are most of the file.

    Raises:
        LogError: if the file is damaged.
    """
    if not (folder / TABLE).exists():
        return
    text = "settings" if settings else "NULL"
    query = f"SELECT id, status, {text}, figures FROM runs WHERE substr(id, 1, ?) = ? ORDER BY rowid"
    with _opened(folder) as base:
        for identity, status, held, figures in base.execute(query, (len(prefix), prefix)):
            more = {"settings": held} if settings else {}
            yield {"id": identity, "status": status, **json.loads(figures), **more}


def table_of(folder: Path, names: Iterable[str]) -> dict[str, Column]:
    """Read the columns (N,) of a table; a missing value is NaN in a column of numbers, else None.

    Raises:
        LogError: if the file is damaged.
    """
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for row in rows_of(folder, settings="settings" in columns):
        for name, values in columns.items():
            values.append(row.get(name))
    return {name: _column(values) for name, values in columns.items()}


def _column(values: Sequence[Any]) -> Column:
    """Column as an array (N,) of numbers with NaN for missing values; as texts if it has a text or no value."""
    kinds = {type(value) for value in values} - {type(None)}
    if kinds and kinds <= {int, float}:
        return np.array([math.nan if value is None else float(value) for value in values], dtype=np.float64)
    return [None if value is None else str(value) for value in values]


@contextmanager
def _opened(folder: Path) -> Iterator[sqlite3.Connection]:
    """Atomic transaction; a `LogError` if the file is damaged, or cannot be read or written."""
    path = folder / TABLE
    try:
        with closing(sqlite3.connect(path, timeout=_BUSY_S)) as base, base:
            yield base
    except sqlite3.OperationalError as error:
        raise LogError(
            f"{path}: cannot be read or written ({error}), expected a table of runs and a disk with room"
        ) from None
    except (sqlite3.DatabaseError, json.JSONDecodeError) as error:
        raise LogError(f"{path}: not a table of runs ({error}); remove it to have its rows done again") from None

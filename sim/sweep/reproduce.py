"""One row of a sweep again, and whether it comes out the same to the last bit."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hystmpc.trials.errors import ConfigError, LogError, did_you_mean

from ..compare import compare
from ..config import SimulationConfig
from .plan import Hashes
from .store import files_of, table_of
from .worker import RESULT_COLUMNS, metrics_columns, run_settings

_NEAR = 20  # ids that an error names


@dataclass(frozen=True)
class Figure:
    """One figure of a row: as the table has it, as it came out again."""

    name: str
    before: Any
    again: Any

    @property
    def equal(self) -> bool:
        """Whether they are the same to the last bit; both missing is the same."""
        both_nan = all(isinstance(v, float) and math.isnan(v) for v in (self.before, self.again))
        return both_nan or bool(self.before == self.again)


def reproduce(folder: Path | str, identity: str, out: Path | str | None = None) -> tuple[Figure, ...]:
    """Run one row from nothing but what the table says of it.

    Args:
        folder: of the sweep.
        identity: of the row, or its first digits where no other begins with them.
        out: a new or empty run folder for settings, log and report of the run.

    Returns:
        Every figure that does not depend on how fast the machine is.

    Raises:
        ConfigError: if there is no such row, a model file has changed, or `out` is not vacant.
        LogError: if the folder holds no table, or the row's run could not be made before.
        HystmpcError: if it cannot be made now.
        KeyboardInterrupt: if the user ended it.
    """
    row = _row(Path(folder), identity)
    config = SimulationConfig.parse(json.loads(str(row["settings"])), f"{folder}: row {row['id']}")
    if list(Hashes().of(config)) != json.loads(str(row["files"])):
        raise ConfigError(f"{folder}: row {row['id']}: a model file has changed since, expected those of the sweep")
    if out is not None:
        metrics = compare(config, out).results[0].metrics
    else:
        metrics, _ = run_settings(config)
    again = metrics_columns(metrics)
    return tuple(Figure(name, _plain(row[name], kind), again[name]) for name, kind in RESULT_COLUMNS.items())


def _row(folder: Path, identity: str) -> dict[str, Any]:
    """Columns of one row."""
    if not files_of(folder):
        raise LogError(f"{folder}: no table of runs in it, expected the folder of a sweep")
    names = ["id", "status", "message", "settings", "files", *RESULT_COLUMNS]
    table = table_of(folder, names)
    ids = [str(found) for found in table["id"]]
    places = [k for k, found in enumerate(ids) if found.startswith(identity)]
    if len(places) != 1:
        number = "no" if not places else f"{len(places)} rows, not one,"
        raise ConfigError(f"{folder}: {number} row {identity!r}, {did_you_mean(identity, ids[:_NEAR])}")
    row = {name: table[name][places[0]] for name in names}
    if row["status"] != "done":
        raise LogError(f"{folder}: row {row['id']} failed ({row['message']}), expected one that was run")
    return row


def _plain(value: Any, kind: str) -> Any:
    return str(value) if kind == "text" else int(value) if kind == "whole" else float(value)

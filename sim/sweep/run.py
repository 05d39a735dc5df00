"""Execution of a sweep in a resumable run folder, and repetition of one of its rows."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from hystmpc.trials.errors import ConfigError, LogError, did_you_mean
from hystmpc.trials.run_folder import RunFolder, alone_in, resumed_folder
from hystmpc.trials.types import Progress

from ..compare import compare
from ..jobs import Backend, run_jobs
from ..two_axes.config import parse_study
from .plan import (
    COST_COLUMNS,
    ROW_COLUMNS,
    SweepPlan,
    SweepRow,
    file_hashes,
    metrics_columns,
    result_columns,
    run_row,
    run_settings,
)
from .report import SweepView, sweep_report
from .settings import SweepSettings, sweep_in
from .table import COPY, TABLE, RunTable, rows_of

_NEAR = 20  # ids listed in an error


@dataclass(frozen=True)
class SweepOutcome:
    """Outcome of a sweep: files, numbers of rows, and the number of failed rows with the first error."""

    table: Path
    report: Path
    rows: int
    kept: int
    failed: int
    message: str
    others: int  # rows of the table outside this plan, made by an earlier form of the sweep


def run_sweep(
    settings: SweepSettings,
    out: Path | str,
    backend: Backend,
    progress: Progress | None = None,
    source: Path | None = None,
) -> SweepOutcome:
    """Run every row that is not done yet, collect all of them in one table, and report.

    Args:
        settings: with the study in them, as `load_sweep` gives them.
        out: a new or empty folder, or one of a sweep, whose rows are kept; the sweep may have grown or changed.

    Raises:
        ConfigError: if settings do not fit the study, the folder holds something else, or workers die repeatedly.
        LogError: if the table is damaged.
        ModelError: on an unknown built-in model.
        KeyboardInterrupt: if the user ended it; finished rows are kept.
    """
    plan = SweepPlan(settings, source)
    total = plan.check()
    backend.check()
    folder = open_folder(Path(out), settings)
    with alone_in(folder.path):
        table = RunTable(folder.path)
        done = table.done()
        ids: set[str] = set()

        def is_done(row: SweepRow) -> bool:
            ids.add(row.id)
            return row.id in done

        try:
            for row_done in run_jobs(
                run_row, plan.rows(), backend, is_done=is_done, total=total, progress=progress, note=lambda r: r["id"]
            ):
                table.add(row_done)
        finally:
            copy = table.copy(columns_of(plan))
        if copy is None:
            raise ConfigError(f"{folder.path}: the sweep has no rows")
        view = SweepView.of(folder.path, plan.columns(), ids)
        report = folder.write_report(sweep_report(view, folder.meta))
    failed = view.failed()
    message = failed[0][1] if failed else ""
    return SweepOutcome(copy, report, len(ids), len(ids & done), len(failed), message, len(done - ids))


def columns_of(plan: SweepPlan) -> tuple[str, ...]:
    """Return the names of all columns of the table, in order."""
    return (*ROW_COLUMNS, *plan.columns(), *result_columns(plan.axes), *COST_COLUMNS)


def open_folder(path: Path, settings: SweepSettings) -> RunFolder:
    """Open a run folder, new or of an earlier call; a `ConfigError` if it holds another kind of data."""
    plain = settings.model_dump(mode="json")
    plain["draw"] = {name: draw.model_dump(mode="json", exclude_none=True) for name, draw in settings.draw.items()}

    def refusal(_: object) -> str:
        if not sweep_in(path):
            return "holds another kind of run, expected a new folder or that of a sweep"
        old = [name for name in (COPY, "runs.parquet", "shards") if (path / name).exists()]
        if old and not (path / TABLE).exists():
            return f"holds {old[0]} of an earlier version of hystmpc, expected a new folder"
        return ""

    return resumed_folder(path, plain, settings.draw_seed, refusal)


@dataclass(frozen=True)
class ReproducedFigure:
    """Value of one metric in the table and in its repetition."""

    name: str
    before: Any
    repeated: Any

    @property
    def equal(self) -> bool:
        """Whether both values are bitwise equal; two missing ones count as equal."""
        both_nan = all(isinstance(v, float) and math.isnan(v) for v in (self.before, self.repeated))
        return both_nan or bool(self.before == self.repeated)


def reproduce(folder: Path | str, identity: str, out: Path | str | None = None) -> tuple[ReproducedFigure, ...]:
    """Repeat one row from the table alone; returns every value that does not depend on the machine's speed.

    Args:
        identity: of the row, or its first digits where they are unique.

    Raises:
        ConfigError: if there is no such row, a model file has changed, or `out` is not vacant.
        LogError: if the folder holds no table, or the row failed before.
        HystmpcError: if it cannot be run now.
    """
    row = _row(Path(folder), identity)
    config = parse_study(json.loads(str(row["settings"])), f"{folder}: row {row['id']}")
    if list(file_hashes(config)) != json.loads(str(row["files"])):
        raise ConfigError(f"{folder}: row {row['id']}: a model file has changed since, expected those of the sweep")
    result = run_settings(config) if out is None else compare(config, out).results[0]
    repeated, names = metrics_columns(result), result_columns(len(result.run.axis_rmse_deg))
    before = {name: math.nan if row[name] is None else row[name] for name in names}
    return tuple(ReproducedFigure(name, before[name], repeated[name]) for name in names)


def _row(folder: Path, identity: str) -> dict[str, Any]:
    """Row with an id, or with the only id that begins with these digits."""
    if not (folder / TABLE).exists():
        raise LogError(f"{folder}: no table of runs in it, expected the folder of a sweep")
    rows = list(rows_of(folder, identity, settings=True))
    if len(rows) != 1:
        number = "no" if not rows else f"{len(rows)} rows, not one,"
        near = [str(row["id"]) for row in islice(rows_of(folder), _NEAR)]
        raise ConfigError(f"{folder}: {number} row {identity!r}, {did_you_mean(identity, near)}")
    row = rows[0]
    if row["status"] != "done":
        raise LogError(f"{folder}: row {row['id']} failed ({row['message']}), expected one that was run")
    return row

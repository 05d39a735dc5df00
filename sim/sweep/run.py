"""A whole sweep: rows, table, report; in a run folder that it goes on from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.run_folder import RunFolder

from ..parallel.backend import Backend
from .plan import Plan, Row
from .report import SweepView, sweep_report
from .settings import SweepSettings, sweep_in
from .store import Store, alone_in
from .worker import COST_COLUMNS, RESULT_COLUMNS, ROW_COLUMNS, run_row

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class SweepOutcome:
    """What became of a sweep.

    Attributes:
        table: the file of all rows.
        report: the page.
        rows: of the plan.
        kept: rows that were done before.
        failed: rows whose run could not be made, with the first error.
        message: that error, empty without one.
        others: rows of the table that are none of this plan, made by an earlier form of the sweep.
    """

    table: Path
    report: Path
    rows: int
    kept: int
    failed: int
    message: str
    others: int


def run_sweep(
    settings: SweepSettings,
    out: Path | str,
    backend: Backend,
    progress: Progress | None = None,
    source: Path | None = None,
) -> SweepOutcome:
    """Run every row that is not done yet, keep all of them in one table, and report.

    Args:
        settings: with the study in them, as `load_sweep` gives them.
        out: a new or empty folder, or one of a sweep, whose rows are kept; the sweep may have grown or changed.
        backend: where the runs are made.
        progress: called with rows done, their number and the id of the last; and once at the start.
        source: file of the sweep, for messages.

    Raises:
        ConfigError: if settings do not fit the study, the folder holds something else, or workers die again and again.
        LogError: if the table is damaged.
        ModelError: on an unknown built-in model.
        KeyboardInterrupt: if the user ended it; finished rows are kept.
    """
    plan = Plan(settings, source)
    total = plan.check()
    backend.check()
    folder = open_folder(Path(out), settings)
    with alone_in(folder.path):
        store = Store(folder.path, columns_of(plan))
        done = store.done()
        seen = Counted(plan.rows(), done)
        try:
            for number, row in enumerate(backend.results(run_row, seen), start=1):
                store.add(row)
                if progress:
                    progress(seen.kept + number, total, str(row["id"]))
        finally:
            table = store.merge()
        if table is None:
            raise ConfigError(f"{folder.path}: the sweep has no rows")
        view = SweepView.of(folder.path, plan.columns(), seen.ids)
        report = folder.write_report(sweep_report(view, folder.meta).html())
    failed = view.failed()
    message = failed[0][1] if failed else ""
    return SweepOutcome(table, report, len(seen.ids), seen.kept, len(failed), message, len(done - seen.ids))


class Counted:
    """Rows that are not done yet; counts all on the way.

    Args:
        rows: of a plan.
        done: ids that are left out.
    """

    def __init__(self, rows: Iterator[Row], done: set[str]) -> None:
        self._rows, self._done = rows, done
        self.ids: set[str] = set()
        self.kept = 0

    def __iter__(self) -> Iterator[Row]:
        """Row after row."""
        for row in self._rows:
            self.ids.add(row.id)
            if row.id in self._done:
                self.kept += 1
            else:
                yield row


def columns_of(plan: Plan) -> dict[str, str]:
    """Kinds of all columns of the table, in their order."""
    return {**ROW_COLUMNS, **plan.columns(), **RESULT_COLUMNS, **COST_COLUMNS}


def open_folder(path: Path, settings: SweepSettings) -> RunFolder:
    """A new run folder, or the one that a sweep left.

    Raises:
        ConfigError: if it holds something else.
        LogError: if it holds a run of another format.
    """
    plain = settings.model_dump(mode="json")
    plain["draw"] = {name: draw.model_dump(mode="json", exclude_none=True) for name, draw in settings.draw.items()}
    if not (path / "meta.json").exists():
        return RunFolder.create(path, plain, seed=settings.draw_seed)
    folder = RunFolder.open(path)
    if sweep_in(path) is None:
        raise ConfigError(f"{path}: holds another kind of run, expected a new folder or that of a sweep")
    write_atomically(path / "config.yaml", dump_yaml(plain))
    return folder

"""Consoles, tables and progress bars that the verbs share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table


def plain_console(**options: Any) -> Console:
    """A console that shows text as it is: a file may be called `[/red].csv` or `:bell:.csv`."""
    return Console(markup=False, emoji=False, **options)


out = plain_console()
errors = plain_console(stderr=True)

INTERRUPTED = 130
"""Exit status of a command that the user ended."""


class Bar:
    """A progress bar with time left and a changing note, on standard error."""

    def __init__(self, progress: Progress, title: str, total: float | None) -> None:
        self._progress = progress
        self._shown = False
        self._task = progress.add_task(title, total=total, note="")

    def __call__(self, done: float, note: str = "", total: float | None = None) -> None:
        """Move to `done`; a total may become known or change on the way. The first call makes the bar appear."""
        if not self._shown:
            self._progress.start()
            self._shown = True
        if total is not None:
            self._progress.update(self._task, total=total)
        self._progress.update(self._task, completed=done, note=note)

    def close(self) -> None:
        """Leave the bar as it stands; one that never moved leaves nothing."""
        if self._shown:
            self._progress.stop()


@contextmanager
def bar(title: str, total: float | None = None) -> Iterator[Bar]:
    """Show a progress bar while the block runs; nothing of it stays on a screen that is not a terminal."""
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    shown = Bar(Progress(*columns, console=errors, transient=False), title, total)
    try:
        yield shown
    finally:
        shown.close()


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], last_apart: bool = False) -> Table:
    """A table whose first column is text and whose others are numbers; the last row may stand apart."""
    grid = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for k, name in enumerate(columns):
        grid.add_column(name, justify="left" if k == 0 else "right", overflow="fold")
    for k, row in enumerate(rows):
        if last_apart and k == len(rows) - 1:
            grid.add_section()
        grid.add_row(*row)
    return grid

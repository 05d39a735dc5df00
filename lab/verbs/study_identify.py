"""`hystmpc study identify`: devices drawn at random, identified from logs and controlled as identified; the bars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystmpc.cli.console import out, table
from hystmpc.trials.run_folder import require_resumable

from ..identify.settings import IdentifySettings
from .study_jobs import completed, ended

if TYPE_CHECKING:
    from ..blind.bars import Bar


def identify(changes: dict[str, Any], folder: Path, workers: int) -> None:
    """Say how long it will take, do it, print the bars and what failed.

    Raises:
        ConfigError: on a number out of bounds, or a folder that holds something else.
        FitError: on an unknown kind of model.
        LogError: if a result in the folder is damaged.
        typer.Exit: with 130 if the user ended it.
    """
    from ..identify.bars import bars  # as other studies: late
    from ..identify.run import prepare_identify, run_identify

    settings = IdentifySettings.of(**changes)
    require_resumable(folder)
    ready = prepare_identify(settings, folder)
    outcome = completed(ready, settings.study, workers, lambda progress: run_identify(ready, workers, progress))
    show_bars(bars(outcome))
    ended(outcome, folder)


def show_bars(judged: Sequence[Bar]) -> None:
    """A table of bars, their numbers and goals."""
    from ..page import bars_table

    rows = [[row[0], row[1], row[3], row[4], row[5]] for row in bars_table(judged).rows]
    shown = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    out.print(table("Bars", ("bar", "number", "goal", "devices", "state"), shown))

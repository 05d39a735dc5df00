"""`hystmpc study control`: every controller on every plant along every motion, and the bars."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hystmpc.cli.console import out, table
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import require_resumable

from ..control.bars import ControlOutcome, verdicts
from ..control.report import bars_table
from ..control.settings import ControlSettings
from .study_jobs import completed, ended


def control(changes: dict[str, Any], folder: Path, workers: int) -> None:
    """Say how long it will take, do it, print the bars and what failed.

    Raises:
        ConfigError: on unknown names, or a folder that holds something else.
        LogError: if a result in the folder is damaged.
        typer.Exit: with 130 if the user ended it.
    """
    from ..control.run import prepare_control, run_control  # as other studies: late

    settings = ControlSettings.of(**changes)
    require_resumable(folder)
    ready = prepare_control(settings, folder)
    outcome = completed(ready, settings.study, workers, lambda progress: run_control(ready, workers, progress))
    out.print(table("Bars", ("bar", "at most", "met by", "of", "worst", "verdict"), _bar_rows(outcome)))
    ended(outcome, folder)


def _bar_rows(outcome: ControlOutcome) -> list[list[str]]:
    """The bars without the place of their worst figure, which the report tells."""
    rows = bars_table(verdicts(outcome)).rows
    shown = [[*row[:5], row[6]] for row in rows]
    return [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in shown]


def rates(text: str | None) -> tuple[float, ...]:
    """Rates between commas [Hz].

    Raises:
        ConfigError: if one is not a number.
    """
    found = []
    for part in (text or "").split(","):
        try:
            found += [float(part)] if part.strip() else []
        except ValueError:
            raise ConfigError(f"--rates: got {part.strip()!r}, expected numbers such as 25,250") from None
    return tuple(found)

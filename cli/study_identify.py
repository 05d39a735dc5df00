"""`hystmpc study identify`: devices drawn at random, identified from logs and controlled as identified; the bars."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from hystmpc.studies.identify.settings import IdentifySettings
from hystmpc.trials.run_folder import require_resumable

from .console import bar, errors, out, table

INTERRUPTED = 130


def identify(changes: dict[str, Any], folder: Path, workers: int) -> None:
    """Say how long it will take, do it, print the bars and what failed.

    Raises:
        ConfigError: on a number out of bounds, or a folder that holds something else.
        FitError: on an unknown kind of model.
        LogError: if a result in the folder is damaged.
        typer.Exit: with 130 if the user ended it.
    """
    from hystmpc.studies.identify.bars import bars  # as other studies: late
    from hystmpc.studies.identify.report import bars_table
    from hystmpc.studies.identify.run import prepare_identify, run_identify

    settings = IdentifySettings.of(**changes)
    require_resumable(folder)
    ready = prepare_identify(settings, folder)
    minutes = ready.minutes(workers)
    errors.print(f"{len(ready.open)} of {len(ready.jobs)} devices to do on {workers} cores: about {minutes} min")
    try:
        with bar("study identify", sum(ready.costs[key] for key in ready.open)) as show:
            outcome = run_identify(ready, workers, lambda done, total, note="": show(done, note, total=total))
    except KeyboardInterrupt:
        errors.print(f"interrupted: finished devices are kept in {folder}, the same command goes on", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    for failed in outcome.failed:
        errors.print(f"failed: {failed.job.key}: {failed.message}", style="red", highlight=False)
    rows = [[row[0], row[1], row[3], row[4], row[5]] for row in bars_table(bars(outcome)).rows]
    shown = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    out.print(table("Bars", ("bar", "number", "goal", "devices", "state"), shown))
    out.print(f"{len(outcome.done)} devices done, {len(outcome.failed)} failed; report: {folder / 'report.html'}")

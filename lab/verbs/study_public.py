"""`hystmpc study public`: a public benchmark, our errors beside the published ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hystmpc.cli.console import out, table
from hystmpc.trials.run_folder import require_resumable

from ..public.settings import PublicSettings
from .study_jobs import completed, ended


def public(changes: dict[str, Any], folder: Path, workers: int) -> None:
    """Say how long it will take, do it, print the errors and what failed.

    Raises:
        ConfigError: on an unknown data set, or a folder that holds something else.
        FitError: on an unknown kind of model.
        LogError: if a record cannot be used, or a result in the folder is damaged.
        typer.Exit: with 130 if the user ended it.
    """
    from ..public.report import errors_table  # as other studies: late
    from ..public.run import prepare_public, run_public

    settings = PublicSettings.of(**changes)
    require_resumable(folder)
    ready = prepare_public(settings, folder)
    outcome = completed(ready, settings.study, workers, lambda progress: run_public(ready, workers, progress))
    errors = errors_table(outcome)
    shown = [[f"{value:.3g}" if isinstance(value, float) else str(value) for value in row] for row in errors.rows]
    out.print(table(errors.caption, errors.columns, shown))
    ended(outcome, folder)

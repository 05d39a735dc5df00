"""`hystmpc study commission`: devices drawn at random and commissioned; the bars."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hystmpc.trials.run_folder import require_resumable

from ..commission.settings import CommissionStudySettings
from .study_identify import show_bars
from .study_jobs import completed, ended


def commission(changes: dict[str, Any], folder: Path, workers: int) -> None:
    """Say how long it will take, do it, print the bars and what failed.

    Raises:
        ConfigError: on a number out of bounds, or a folder that holds something else.
        LogError: if a result in the folder is damaged.
        typer.Exit: with 130 if the user ended it.
    """
    from ..commission.bars import bars  # as other studies: late
    from ..commission.run import prepare_commission, run_commission

    settings = CommissionStudySettings.of(**changes)
    require_resumable(folder)
    ready = prepare_commission(settings, folder)
    outcome = completed(ready, settings.study, workers, lambda progress: run_commission(ready, workers, progress))
    show_bars(bars(outcome))
    ended(outcome, folder)

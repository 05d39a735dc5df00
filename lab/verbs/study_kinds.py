"""`hystmpc study kinds`: the study on recorded logs of several devices, and which kind of model to try first."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from hystmpc.cli.console import errors, out, table
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import require_writable
from hystmpc.trials.run_folder import require_resumable

from ..papers.devices import device_settings
from .study_jobs import completed


def kinds(changes: dict[str, Any], folder: Path, workers: int) -> None:
    """Do the study of each device in a folder of its own, then write the tables over all of them.

    Raises:
        ConfigError: without a list of devices, or with a wrong one; if a folder holds something else.
        LogError: if a log cannot be read, or a result in a folder is damaged.
        typer.Exit: with 130 if the user ended it.
    """
    from ..papers.devices import kinds_report
    from ..papers.run import prepare, run_study  # kept out of the way of the other verbs' start

    file = changes.pop("data")
    if file is None:
        raise ConfigError("study kinds: got no --data, expected a YAML file of devices and their logs")
    require_writable(folder)
    settings = device_settings(file, **changes)
    for name in settings:
        require_resumable(folder / name)
    outcomes = {}
    for name, own in settings.items():
        errors.print(f"{name}: timing a few steps of every kind ...")
        study = prepare(own, folder / name)
        outcomes[name] = completed(study.ready, name, workers, partial(run_study, study, workers))
    page, tables = kinds_report(outcomes)
    for one in tables:
        one.save(folder)
        shown = [[f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row] for row in one.rows]
        out.print(table(one.caption, one.columns, shown))
    page.save(folder / "report.html")
    out.print(f"report: {folder / 'report.html'}", soft_wrap=True)

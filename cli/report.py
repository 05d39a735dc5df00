"""`hystmpc report`: the report of a run folder, made anew from what lies in it."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import Annotated

import typer

from hystmpc.trials.config import read_yaml
from hystmpc.trials.run_folder import RunFolder

from .console import out


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder of `simulate`, `demo`, `run` or `record`.")],
) -> None:
    """Write report.html of a run folder again.

    Of an experiment it says what is due: nothing, `fit` or `diagnose`.
    """
    keys = _settings_of(run)
    if {"transport", "sensor", "reference"} <= keys:
        from hystmpc.rig.commission.review_page import review_run

        out.print(f"review: {review_run(run).advice}", soft_wrap=True)
        out.print(f"report: {run / 'report.html'}", soft_wrap=True)
    elif {"transport", "sensor", "excitations"} <= keys:
        from hystmpc.rig.recording.report import write_report

        out.print(f"report: {write_report(RunFolder.open(run))}", soft_wrap=True)
    else:
        from hystmpc.sim.report import report_from_folder

        out.print(f"report: {report_from_folder(run)}")


def _settings_of(run: Path) -> Set[str]:
    """The keys of the run's settings; none where there are none."""
    file = run / "config.yaml"
    settings = read_yaml(file) if file.is_file() else None
    return settings.keys() if isinstance(settings, dict) else frozenset()

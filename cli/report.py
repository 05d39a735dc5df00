"""`hystmpc report`: the report of a run folder, made anew from what lies in it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.sim.report import report_from_folder
from hystmpc.trials.config import read_yaml

from .console import out


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder as `simulate`, `demo` or `run` leave it.")],
) -> None:
    """Write report.html of a run folder again; of an experiment it says what is due: nothing, `fit` or `diagnose`."""
    if _at_a_bench(run):
        from hystmpc.rig.review import review_run

        out.print(f"review: {review_run(run).advice}", soft_wrap=True, markup=False)
        out.print(f"report: {run / 'report.html'}", soft_wrap=True)
        return
    out.print(f"report: {report_from_folder(run)}")


def _at_a_bench(run: Path) -> bool:
    """Whether the folder is that of an experiment on a device."""
    file = run / "config.yaml"
    settings = read_yaml(file) if file.is_file() else None
    return isinstance(settings, dict) and {"transport", "sensor", "reference"} <= settings.keys()

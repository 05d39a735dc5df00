"""`hystmpc report`: the report of a run folder, made anew from what lies in it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.tasks.report import report as write_report

from .bars import bar
from .console import out
from .options import Figures


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder, or that of a commissioning.")],
    before: Annotated[
        list[Path] | None, typer.Option("--before", help="Earlier run on the same reference; repeatable.")
    ] = None,
    diagnosis: Annotated[
        Path | None, typer.Option("--diagnosis", help="Folder of `diagnose`: the fall that it lets expect.")
    ] = None,
    figures: Figures = None,
) -> None:
    """Write report.html of a run folder again.

    Of an experiment it says what is due: nothing, `fit` or `diagnose`. With an earlier run it says how far the tracking
    error fell, and with a diagnosis how far it was expected to fall on this reference.
    """
    with bar("report"):
        written = write_report(run, before=before or (), diagnosis=diagnosis, figures=figures)
    for line in written.lines:
        out.print(line, soft_wrap=True, markup=False, highlight=False)
    out.print(f"report: {written.path}", soft_wrap=True)

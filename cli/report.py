"""`hystmpc report`: the report of a run folder, made anew from what lies in it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.sim.report import report_from_folder

from .console import out


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder as `simulate` or `demo` leave it.")],
) -> None:
    """Write report.html of a run folder again."""
    out.print(f"report: {report_from_folder(run)}")

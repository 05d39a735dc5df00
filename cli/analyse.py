"""Subcommand `analyse`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import typer

from .console import line, out, say, table
from .verb import OPTIONAL, Call, verb

if TYPE_CHECKING:
    from hystmpc.ctrl.linear.report import LoopsAnalysis

OSCILLATES = 1

_COLUMNS = ("controller", "gain", "phase", "disk", "Ms", "delay", "lag [s]", "deg", "Hz")


@verb(
    "analyse:analyse",
    config={"metavar": "CONFIG", "help": "A tip's file, or a study: model and controllers (YAML)."},
    out={**OPTIONAL, "help": "Run folder for the report; new or empty."},
    command={"kind": float},
    tolerance_deg={"kind": float},
)
def analyse(call: Call) -> None:
    """The exit code is 1 where a loop is unstable, or its predicted oscillation exceeds what a hold may have."""
    analysis: LoopsAnalysis = call.run("analyse")
    rows = [[_text(value) for value in row[:-1]] for row in analysis.rows()]
    words = "margins of the linearised loop, delay survived [samples], lag up to Ms 2, limit cycle"
    out.print(table(f"{words}; command [{analysis.unit}]", _COLUMNS, rows))
    for one in analysis.controllers:
        line(f"{one.name}: {one.rest}")
        for note in one.notes:
            line(f"  note: {note}")
    if call.out is not None:
        line(f"report: {call.out / 'report.html'}")
    marked = [one.name for one in analysis.controllers if one.too_great]
    if marked:
        say(f"too great for a hold: {', '.join(marked)}", style="red")
        raise typer.Exit(OSCILLATES)


def _text(value: object) -> str:
    if isinstance(value, float):
        return "inf" if math.isinf(value) else f"{value:.3g}"
    return str(value)

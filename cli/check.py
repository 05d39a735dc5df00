"""`hystmpc check`: can these logs be used, and what is in them?"""

from __future__ import annotations

import typer
from rich.table import Table
from rich.text import Text

from hystmpc.trials.check import Severity
from hystmpc.trials.check import check as check_log
from hystmpc.trials.read import expand_logs

from .console import out
from .options import Layout, Logs

_COLOURS = {Severity.OK: "green", Severity.NOTE: "cyan", Severity.WARNING: "yellow", Severity.ERROR: "red"}


def check(logs: Logs, preset: Layout = "auto") -> None:
    """Check logs: can they be used, and what is in them.

    Time base, jitter, gaps, duplicates, NaN, units, sign, segments, first flexure. Exit code 1 if a log cannot be used.
    """
    unusable = False
    for log in expand_logs(logs):
        report = check_log(log, preset)
        grid = Table(title=f"{report.source} ({report.preset})", title_justify="left", show_header=False)
        for finding in report.findings:
            severity = Text(str(finding.severity), style=_COLOURS[finding.severity])
            grid.add_row(severity, finding.topic, finding.message)
        out.print(grid)
        unusable |= report.worst is Severity.ERROR
    if unusable:
        raise typer.Exit(1)

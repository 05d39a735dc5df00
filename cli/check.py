"""`hystmpc check`: can these logs be used, and what is in them?"""

from __future__ import annotations

import typer
from rich.table import Table
from rich.text import Text

from hystmpc.tasks.check import check as check_logs
from hystmpc.trials.check import Severity
from hystmpc.trials.findings import CheckReport

from .bars import progress_of
from .console import out, table
from .options import LayoutName, Logs, SampledHz, Sim

_COLOURS = {Severity.OK: "green", Severity.NOTE: "cyan", Severity.WARNING: "yellow", Severity.ERROR: "red"}


def check(logs: Logs, layout: LayoutName = "auto", sampled_hz: SampledHz = None, sim: Sim = None) -> None:
    """Check logs: can they be used, and what is in them.

    Time base, jitter, gaps, duplicates, NaN, units, sign, segments, first flexure. Exit code 1 if a log cannot be used.
    With --sim also the least size at which `diagnose` would show each effect, from the commands alone.
    """
    with progress_of("check") as progress:
        checked = check_logs(
            logs, layout=layout, sampled_hz=sampled_hz, simulator=sim, show=_print_report, progress=progress
        )
    if checked.worst is Severity.ERROR:
        raise typer.Exit(1)
    if checked.detectable is not None:
        from hystmpc.gap.report.words import DETECTABLE_COLUMNS, detectable_rows, detectable_sentence

        out.print(detectable_sentence(checked.detectable), highlight=False)
        if checked.detectable.effects:
            out.print(table("These logs would show", DETECTABLE_COLUMNS, detectable_rows(checked.detectable)))


def _print_report(report: CheckReport) -> None:
    grid = Table(title=f"{report.source} ({report.layout})", title_justify="left", show_header=False)
    for finding in report.findings:
        severity = Text(str(finding.severity), style=_COLOURS[finding.severity])
        grid.add_row(severity, finding.topic, finding.message)
    out.print(grid)

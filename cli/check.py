"""`hystmpc check`: can these logs be used, and what is in them?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer
from rich.table import Table
from rich.text import Text

from hystmpc.trials.check import Severity
from hystmpc.trials.check import check as check_log
from hystmpc.trials.read import expand_logs, read_trials
from hystmpc.trials.trial import Trial

from .bars import bar, each
from .console import out, table
from .options import Layout, Logs, SampledHz, Sim, simulator_at

if TYPE_CHECKING:
    from hystmpc.models.contract.load import OnnxModel
    from hystmpc.models.simulator import Simulator

_COLOURS = {Severity.OK: "green", Severity.NOTE: "cyan", Severity.WARNING: "yellow", Severity.ERROR: "red"}


def check(logs: Logs, preset: Layout = "auto", sampled_hz: SampledHz = None, sim: Sim = None) -> None:
    """Check logs: can they be used, and what is in them.

    Time base, jitter, gaps, duplicates, NaN, units, sign, segments, first flexure. Exit code 1 if a log cannot be used.
    With --sim also the least size at which `diagnose` would show each effect, from the commands alone.
    """
    simulator, unusable = simulator_at(sim) if sim is not None else None, False
    for log in each("check", expand_logs(logs)):
        report = check_log(log, preset, sampled_hz)
        grid = Table(title=f"{report.source} ({report.preset})", title_justify="left", show_header=False)
        for finding in report.findings:
            severity = Text(str(finding.severity), style=_COLOURS[finding.severity])
            grid.add_row(severity, finding.topic, finding.message)
        out.print(grid)
        unusable |= report.worst is Severity.ERROR
    if unusable:
        raise typer.Exit(1)
    if simulator is not None:
        _print_detectable(read_trials(logs, preset, sampled_hz=sampled_hz), simulator)


def _print_detectable(trials: Sequence[Trial], simulator: Simulator | OnnxModel) -> None:
    """What all logs together would show of the gap between this simulator and its device."""
    from hystmpc.gap.diagnose import detectable_in_logs  # compiles
    from hystmpc.gap.report.words import DETECTABLE_COLUMNS, detectable_rows, detectable_sentence

    with bar("what the logs would show"):
        found = detectable_in_logs(trials, simulator)
    out.print(detectable_sentence(found), highlight=False)
    if found.effects:
        out.print(table("These logs would show", DETECTABLE_COLUMNS, detectable_rows(found)))

"""`hystmpc faults`: the fault campaign, over a real connection, as a table."""

from __future__ import annotations

import math
import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from hystmpc.rig.campaign.cases import CASES, Case
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import require_vacant

from .console import bar, errors, out, table

FAILED = 1

_COLUMNS = ("fault", "has to", "does", "commands", "beyond", "safe after s", "log")


def faults(
    folder: Annotated[Path, typer.Option("--out", help="Folder for the cases, new or empty.")],
    only: Annotated[list[str] | None, typer.Option("--only", help="A part of a case's name; may be repeated.")] = None,
) -> None:
    """Break sensor, wire, processes, disk, model and solver, one after another; exit code 1 if a case fails."""
    from hystmpc.rig.campaign.judge import judge
    from hystmpc.rig.campaign.play import play

    chosen, verdicts = _chosen(folder, only or []), []
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # no device may be left behind
    with bar("faults", len(chosen)) as show:
        for k, case in enumerate(chosen):
            show(k, case.name)
            verdicts.append(judge(case, play(case, folder / f"{k:02d}")))
        show(len(chosen))
    rows = [[v.name, v.expected, v.got, str(v.commands), str(v.beyond), _seconds(v.safe_s), v.log] for v in verdicts]
    out.print(table("fault campaign over UDP, device and controller in two processes", _COLUMNS, rows))
    out.print("what the user sees:")
    for v in verdicts:
        out.print(f"  {v.name}: {v.seen}", soft_wrap=True, markup=False, highlight=False)
    failed = [v.name for v in verdicts if not v.passed]
    if failed:
        errors.print(f"failed: {', '.join(failed)}", style="red", soft_wrap=True, markup=False)
        raise typer.Exit(FAILED)
    out.print(f"{len(verdicts)} cases, all as they have to be; no command beyond the limits")


def _chosen(folder: Path, only: list[str]) -> list[Case]:
    """The cases to play, in a folder that is new or empty.

    Raises:
        ConfigError: on an unknown case, or a folder that is not empty.
    """
    chosen = [case for case in CASES if not only or any(text in case.name for text in only)]
    if not chosen:
        raise ConfigError(f"--only: got {', '.join(only)}, available: {'; '.join(case.name for case in CASES)}")
    require_vacant(folder)
    return chosen


def _seconds(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"

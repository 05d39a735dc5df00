"""`hystmpc investigate`: record what tells most about a simulator's gap, diagnose, and go on until it has a name."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hystmpc.tasks.investigate import investigate as investigate_device
from hystmpc.tasks.investigate import investigation_plan

from .bars import progress_of
from .console import out, say, table
from .device_runs import InTerminal, OnPage, Reset, print_plan, stages_kept
from .options import AllowPython, Overrides

if TYPE_CHECKING:
    from hystmpc.bench.rounds import Investigated


def investigate(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="Bench with the block investigate (YAML).")],
    folder: Annotated[Path | None, typer.Option("--out", help="Folder; an investigation begun in it goes on.")] = None,
    minutes: Annotated[float | None, typer.Option("--minutes", help="Device time, never exceeded.")] = None,
    model: Annotated[
        str | None, typer.Option("--model", help="Simulator to be judged (.yaml); identified first where left out.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and end.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print investigation.json and nothing else.")] = False,
    overrides: Overrides = None,
    reset: Reset = False,
    live: InTerminal = False,
    page: OnPage = False,
    allow: AllowPython = False,
) -> None:
    """Find out why a simulator and its device differ: record, diagnose, record what decides most.

    Ctrl-C keeps what is complete; the same command goes on. Exit code 0 whatever the verdict, 3 after a safe stop, 1 if
    a part could not be completed, 130 if Ctrl-C ended a computation.
    """
    changes = overrides or ()
    if not as_json and (dry_run or folder is not None):
        plan = investigation_plan(config, changes, model=model, minutes=minutes, allow_python=allow)
        print_plan(plan, "part")
    if dry_run:
        return
    kept = f"interrupted: complete parts are kept in {folder}, the same command goes on"
    with stages_kept(folder), progress_of("investigate", kept=kept) as progress:
        made = investigate_device(
            config,
            folder,
            model=model,
            minutes=minutes,
            overrides=changes,
            reset=reset,
            live=live,
            page=page,
            allow_python=allow,
            progress=progress,
            say=say,
        )
    if as_json:
        sys.stdout.write(json.dumps(made.as_json(), indent=1, allow_nan=False) + "\n")
    else:
        _print_end(made)


def _print_end(made: Investigated) -> None:
    rows = [
        (str(part.number), f"{part.recorded.device_s:.0f}", part.judged.headline, f"{part.judged.left_deg:.3f}")
        for part in made.rounds
    ]
    out.print(table("rounds", ("round", "device time [s]", "verdict", "left [deg]"), rows, True))
    out.print(made.verdict.reason, soft_wrap=True, highlight=False)
    out.print(f"ended: {made.why}", soft_wrap=True, highlight=False)
    if made.fixed is not None:
        out.print(f"corrected simulator: {made.fixed}", soft_wrap=True)
    out.print(f"report: {made.report}", soft_wrap=True)

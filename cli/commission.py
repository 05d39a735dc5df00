"""`hystmpc commission`: from a device, or from its logs, to a controller and its report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hystmpc.tasks.commission import commission as commission_device
from hystmpc.tasks.commission import commission_plan

from .bars import progress_of
from .console import out, say, table
from .device_runs import InTerminal, OnPage, Reset, print_plan, stages_kept
from .options import AllowPython, Overrides

if TYPE_CHECKING:
    from hystmpc.bench.commission import Commissioned


def commission(
    config: Annotated[
        Path | None, typer.Argument(metavar="[CONFIG]", help="Bench with the block commission (YAML).")
    ] = None,
    folder: Annotated[Path | None, typer.Option("--out", help="Folder; a commissioning begun in it goes on.")] = None,
    logs: Annotated[
        list[Path] | None, typer.Option("--logs", help="Recording or folder in place of the device; repeatable.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and end.")] = False,
    overrides: Overrides = None,
    reset: Reset = False,
    live: InTerminal = False,
    page: OnPage = False,
    allow: AllowPython = False,
) -> None:
    """Find safe range and rate, record, identify, make a controller, verify it, report.

    The device moves for five minutes at most. Ctrl-C keeps what is complete; the same command goes on. Exit code 3
    after a safe stop, 1 if a stage could not be completed, 130 if Ctrl-C ended a computation.
    """
    changes = overrides or ()
    if config is not None and not logs and (dry_run or folder is not None):
        print_plan(commission_plan(config, changes, allow_python=allow), "stage")
    if dry_run and (config is not None or (logs and not changes)):
        return
    kept = f"interrupted: complete stages are kept in {folder}, the same command goes on"
    with stages_kept(folder), progress_of("commission", kept=kept) as progress:
        made = commission_device(
            config,
            folder,
            logs=logs or (),
            overrides=changes,
            reset=reset,
            live=live,
            page=page,
            allow_python=allow,
            progress=progress,
            say=say,
        )
    _print_end(made)


def _print_end(made: Commissioned) -> None:
    verified = made.verified
    if verified is None:
        out.print("made from logs alone: nothing was verified", soft_wrap=True)
    else:
        rows = [
            (name, f"{s.rms_deg:.3f}", *(f"{v:.3f}" for v in s.by_motion.values()), f"{100 * s.rest_share:.0f} %")
            for name, s in verified.scores.items()
        ]
        motions = next(iter(verified.scores.values())).by_motion
        out.print(table("measured less wanted [deg]", ("controller", "RMS", *motions, "rest in holds"), rows))
        out.print(verified.verdict, soft_wrap=True, highlight=False)
        for step in verified.steps:
            out.print(f"next: {step}", soft_wrap=True, highlight=False)
    out.print(f"controller: {made.tip}", soft_wrap=True)
    out.print(f"report: {made.report}", soft_wrap=True)

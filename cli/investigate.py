"""`hystmpc investigate`: record what tells most about a simulator's gap, diagnose, and go on until it has a name."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Progress

from .bars import bar
from .console import INTERRUPTED, errors, out, table
from .device_runs import InTerminal, OnPage, Overrides, Reset, stages_kept, tell
from .options import AllowPython, heard

if TYPE_CHECKING:
    from hystmpc.bench.config import InvestigateSettings
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
    from hystmpc.bench.config import load_investigation, located_investigation

    heard(allow)
    _check(folder, dry_run)
    settings = located_investigation(load_investigation(config, overrides or ()), config.parent, model, minutes)
    if not as_json:
        _print_plan(settings)
    if dry_run or folder is None:
        return
    try:
        with bar("investigate") as show:

            def told(done: float, total: float, note: str = "") -> None:
                show(round(done), note, total=round(total))

            made = _done(settings, config, folder, reset, (live, page), told)
    except KeyboardInterrupt:
        errors.print(f"interrupted: complete parts are kept in {folder}, the same command goes on", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    if as_json:
        sys.stdout.write(json.dumps(made.as_json(), indent=1, allow_nan=False) + "\n")
    else:
        _print_end(made)


def _check(folder: Path | None, dry_run: bool) -> None:
    """Refuse a call that lacks something."""
    if folder is None and not dry_run:
        raise ConfigError("investigate: lacks --out, expected a folder")


def _done(
    settings: InvestigateSettings,
    config: Path,
    folder: Path,
    reset: bool,
    views: tuple[bool, bool],
    progress: Progress,
) -> Investigated:
    """On the device; a safe stop is said as `run` says it."""
    from hystmpc.bench.device import opened_device
    from hystmpc.bench.investigate import investigate_device
    from hystmpc.rig.recording.recorder_process import Views
    from hystmpc.rig.run import reset_latch

    if reset:
        reset_latch(settings)
    device = opened_device(settings, config.resolve().parent, Views(*views), tell)
    with stages_kept(folder):
        return investigate_device(settings, device, folder, progress)


def _print_plan(settings: InvestigateSettings) -> None:
    """Parts, motions, minutes and limits, before anything moves."""
    from hystmpc.bench.investigate import plan_rows

    rows = [(name, what, f"{minutes:.1f}") for name, what, minutes in plan_rows(settings)]
    where = "computed, faster than time" if settings.transport.in_process else settings.transport.place
    grid = table(f"{settings.name} ({where}): minutes of device time", ("part", "motions", "min"), rows, True)
    grid.columns[1].justify = "left"
    out.print(grid)
    limits, unit, (low, high) = settings.limits, settings.command_unit, settings.angle_limits
    out.print(
        f"limits: command {limits.lower:g} to {limits.upper:g} {unit} at {limits.rate_per_s:g} {unit}/s, angle {low:g} "
        f"to {high:g} deg; every motion starts and ends at {settings.safe_command:g} {unit}",
        soft_wrap=True,
    )


def _print_end(made: Investigated) -> None:
    rows = [
        (str(found.number), f"{found.recorded.device_s:.0f}", found.judged.headline, f"{found.judged.left_deg:.3f}")
        for found in made.rounds
    ]
    out.print(table("rounds", ("round", "device time [s]", "verdict", "left [deg]"), rows, True))
    out.print(made.verdict.reason, soft_wrap=True, highlight=False)
    out.print(f"ended: {made.why}", soft_wrap=True, highlight=False)
    if made.fixed is not None:
        out.print(f"corrected simulator: {made.fixed}", soft_wrap=True)
    out.print(f"report: {made.report}", soft_wrap=True)

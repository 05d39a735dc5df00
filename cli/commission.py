"""`hystmpc commission`: from a device, or from its logs, to a controller and its report."""

from __future__ import annotations

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
    from hystmpc.bench.commission import Commissioned
    from hystmpc.bench.config import CommissionSettings


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
    from hystmpc.bench.config import load_commission

    heard(allow)
    _check(config, logs, overrides, folder, dry_run)
    settings = None if config is None else load_commission(config, overrides or ())
    if settings is not None and not logs:
        _print_plan(settings)
    if dry_run or folder is None:
        return
    try:
        with bar("commission") as show:

            def told(done: float, total: float, note: str = "") -> None:
                show(round(done), note, total=round(total))

            made = _done(settings, config, folder, logs or [], reset, (live, page), told)
    except KeyboardInterrupt:
        errors.print(f"interrupted: complete stages are kept in {folder}, the same command goes on", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    _print_end(made)


def _check(
    config: Path | None, logs: list[Path] | None, overrides: list[str] | None, folder: Path | None, dry_run: bool
) -> None:
    """Refuse a call that lacks something, or says something that would do nothing."""
    if config is None and not logs:
        raise ConfigError("commission: lacks CONFIG, expected a bench file, or --logs with recordings")
    if config is None and overrides:
        raise ConfigError("commission: --set does nothing without CONFIG, expected a bench file")
    if folder is None and not dry_run:
        raise ConfigError("commission: lacks --out, expected a folder")


def _done(
    settings: CommissionSettings | None,
    config: Path | None,
    folder: Path,
    logs: list[Path],
    reset: bool,
    views: tuple[bool, bool],
    progress: Progress,
) -> Commissioned:
    """From logs, or on the device; a safe stop is said as `run` says it."""
    from hystmpc.bench.commission import commission_device, commission_logs
    from hystmpc.bench.device import opened_device
    from hystmpc.rig.recording.recorder_process import Views
    from hystmpc.rig.run import reset_latch

    if logs or settings is None or config is None:
        return commission_logs(logs, folder, settings, progress)
    if reset:
        reset_latch(settings)
    device = opened_device(settings, config.resolve().parent, Views(*views), tell)
    with stages_kept(folder):
        return commission_device(settings, device, folder, progress)


def _print_plan(settings: CommissionSettings) -> None:
    """Stages, motions, minutes and limits, before anything moves."""
    from hystmpc.bench.commission import plan_rows
    from hystmpc.bench.motions import budget

    rows = [(name, what, f"{minutes:.1f}") for name, what, minutes in plan_rows(settings, budget(settings))]
    where = "computed, faster than time" if settings.transport.in_process else settings.transport.place
    grid = table(f"{settings.name} ({where}): minutes of device time", ("stage", "motions", "min"), rows, True)
    grid.columns[1].justify = "left"
    out.print(grid)
    limits, unit, (low, high) = settings.limits, settings.command_unit, settings.angle_limits
    out.print(
        f"limits: command {limits.lower:g} to {limits.upper:g} {unit} at {limits.rate_per_s:g} {unit}/s, angle {low:g} "
        f"to {high:g} deg; every motion starts and ends at {settings.safe_command:g} {unit}",
        soft_wrap=True,
    )


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

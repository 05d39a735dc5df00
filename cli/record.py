"""`hystmpc record`: identification motions on a device, written as trials."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.rig.bench import reset_latch
from hystmpc.rig.config import load_record

from .console import out
from .device import plants_in
from .run import Reset, end, finish, tell


def record(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="Bench and excitations (YAML).")],
    folder: Annotated[Path, typer.Option("--out", help="Run folder, new or empty.")],
    overrides: Annotated[list[str] | None, typer.Option("--set", help="Change a setting: rate_hz=50.")] = None,
    reset: Reset = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show angle, command, timing and faults in the terminal.")
    ] = False,
) -> None:
    """Play every excitation and write trials that `check`, `fit` and `diagnose` read. Exit code 3 after a stop."""
    from hystmpc.rig.record import record as play
    from hystmpc.rig.recording import RecordingMeta, open_apart
    from hystmpc.rig.recording.apart import Views

    settings = load_record(config, overrides or ())
    if reset:
        reset_latch(settings)
    meta = RecordingMeta(settings.command_unit, stages=("execution",))
    result = play(
        settings,
        lambda: open_apart(folder, settings, meta, settings.rate_hz, Views(terminal=live), tell),
        plants_in(config.resolve().parent, settings.command_unit),
        folder,
        note=tell,
    )
    finish(settings, result.bench)
    for trial in result.trials:
        out.print(f"trial: {trial}", soft_wrap=True)
    if result.partial is not None:
        out.print(f"cut short, not a whole trial: {result.partial}", soft_wrap=True)
    end(result.bench)

"""`hystmpc record`: identification motions on a device, written as trials."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.rig.experiment.record import load_record
from hystmpc.tasks.inputs import allow_classes

from .console import out, say
from .device_runs import Folder, InTerminal, OnPage, Reset, begin, end, finish, recording_in, views_of
from .options import AllowPython, Overrides


def record(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="Bench and excitations (YAML).")],
    folder: Folder,
    overrides: Overrides = None,
    reset: Reset = False,
    live: InTerminal = False,
    page: OnPage = False,
    allow: AllowPython = False,
) -> None:
    """Play every excitation and write trials that `check`, `fit` and `diagnose` read. Exit code 3 after a stop."""
    from hystmpc.bench.device import plants_in
    from hystmpc.rig.experiment.record import record as play
    from hystmpc.rig.live.desk import Desk
    from hystmpc.rig.recording.recording import RecordingMeta

    allow_classes(allow)
    settings = load_record(config, overrides or ())
    begin(settings, folder, reset)
    meta = RecordingMeta(settings.command_unit, stages=("execution",))
    desk = Desk(settings.live)
    result = play(
        settings,
        recording_in(folder, settings, meta, views_of(settings.live, live, page), desk),
        plants_in(config.resolve().parent, settings.command_unit),
        folder,
        note=say,
        desk=desk,
    )
    finish(settings, result.bench)
    for trial in result.trials:
        out.print(f"trial: {trial}", soft_wrap=True)
    if result.partial is not None:
        out.print(f"cut short, not a whole trial: {result.partial}", soft_wrap=True)
    end(result.bench)

"""`hystmpc run`: a closed-loop experiment on a device."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.rig.config import load_run
from hystmpc.tasks.inputs import allow_classes

from .console import out, say
from .device_runs import Folder, InTerminal, OnPage, Reset, begin, end, finish, recording_in, views_of
from .options import AllowPython, Overrides


def run(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="Bench, controller and reference (YAML).")],
    folder: Folder,
    overrides: Overrides = None,
    reset: Reset = False,
    live: InTerminal = False,
    page: OnPage = False,
    allow: AllowPython = False,
) -> None:
    """Prepare the device, track the reference, return to the safe command; exit code 3 after a safe stop."""
    from hystmpc.bench.device import plants_in
    from hystmpc.rig.experiment.experiment import run_experiment
    from hystmpc.rig.live.desk import Desk
    from hystmpc.rig.recording.recording import RecordingMeta

    allow_classes(allow)
    settings = load_run(config, overrides or ())
    begin(settings, folder, reset)
    model = settings.controller.model
    meta = RecordingMeta(
        settings.command_unit,
        models=() if model.startswith("builtin:") else (Path(model),),
        stages=("estimate", "law", "advance", "total", "execution"),
    )
    views, desk = views_of(settings.live, live, page), Desk(settings.live)
    result = run_experiment(
        settings,
        recording_in(folder, settings, meta, views, desk, report=False),  # the review writes the one report there is
        plants_in(config.resolve().parent, settings.command_unit),
        folder=folder,
        note=say,
        desk=desk,
    )
    finish(settings, result)
    from hystmpc.rig.experiment.review import review_run  # matplotlib takes a second to import: after the run

    report = folder / "report.html"
    try:
        review = review_run(folder)
    except OSError as error:  # a full disk must not hide how the run ended
        say(f"{report}: not written ({error.strerror}), `hystmpc report {folder}` makes it once there is room")
    else:
        for line in review.lines:
            out.print(f"review: {line}", soft_wrap=True, markup=False)
        out.print(f"report: {report}", soft_wrap=True)
    end(result)

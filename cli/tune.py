"""`hystmpc tune`: settings of a controller by search over plants with drawn effects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.trials.run_folder import require_resumable

from .bars import bar
from .console import INTERRUPTED, errors, out, table
from .options import AllowPython, heard, processes

_COLUMNS = ("settings", "objective", "mean error", "worst plant", "travel", "violations")


def tune(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A tuning: study, ranges, plants (YAML).")],
    folder: Annotated[Path, typer.Option("--out", help="Run folder; an unfinished tuning in it goes on.")],
    overrides: Annotated[list[str] | None, typer.Option("--set", help="Change a setting: trials=200.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes, one thread each; else one a core.")] = None,
    cluster: Annotated[
        str | None, typer.Option(help="Dask scheduler, tcp://host:8786, with a shared --storage; `local`: as --jobs.")
    ] = None,
    storage: Annotated[
        str | None, typer.Option(help="Where trials are kept, such as postgresql://host/db; several machines share it.")
    ] = None,
    allow: AllowPython = False,
) -> None:
    """Search the settings of a controller on simulated plants.

    They are checked on plants not seen; writes controller.yaml and a report.
    """
    from hystmpc.sim.jobs.runner import backend_for  # kept out of the way of the other verbs' start
    from hystmpc.sim.tuning.run import run_tuning
    from hystmpc.sim.tuning.settings import load_tuning

    heard(allow)
    workers = processes(jobs)
    settings = load_tuning(config, overrides or [])
    require_resumable(folder)
    backend = backend_for(workers, cluster, str(folder))
    try:
        with bar("tune") as show:
            found = run_tuning(
                settings, folder, backend, storage, lambda done, total, note="": show(done, note, total=total)
            )
    except KeyboardInterrupt:
        errors.print(f"interrupted: finished trials are kept in {folder}, the same command goes on", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    for failed in found.failed:
        errors.print(f"failed: trial {failed.slot}: {failed.message}", style="red", highlight=False)
    check = found.check
    rows = [[name, *(f"{value:.3f}" for value in figures), str(beyond)] for name, *figures, beyond in check.rows()]
    out.print(table(f"{len(check.given)} plants that the search has not seen [deg]", _COLUMNS, rows))
    low, high = check.interval()
    out.print(
        f"objective {100 * check.gain:.1f} % lower, 90 % interval over plants {100 * low:.1f} to {100 * high:.1f} %"
    )
    out.print(f"controller: {folder / 'controller.yaml'}")
    out.print(f"report: {folder / 'report.html'}")

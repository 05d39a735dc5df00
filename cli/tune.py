"""`hystmpc tune`: settings of a controller by search over plants with drawn effects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.tasks.tune import tune as search

from .bars import progress_of
from .console import errors, out, table
from .options import AllowPython, Cluster, Overrides

_COLUMNS = ("settings", "objective", "mean error", "worst plant", "travel", "violations")


def tune(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A tuning: study, ranges, plants (YAML).")],
    folder: Annotated[Path, typer.Option("--out", help="Run folder; an unfinished tuning in it goes on.")],
    overrides: Overrides = None,
    jobs: Annotated[int | None, typer.Option(help="Processes, one thread each; else one a core.")] = None,
    cluster: Cluster = None,
    storage: Annotated[
        str | None, typer.Option(help="Where trials are kept, such as postgresql://host/db; several machines share it.")
    ] = None,
    allow: AllowPython = False,
) -> None:
    """Search the settings of a controller on simulated plants.

    They are checked on plants not seen; writes controller.yaml and a report.
    """
    kept = f"interrupted: finished trials are kept in {folder}, the same command goes on"
    with progress_of("tune", kept=kept) as progress:
        tuning = search(
            config,
            folder,
            overrides=overrides or (),
            jobs=jobs,
            cluster=cluster,
            storage=storage,
            allow_python=allow,
            progress=progress,
        )
    for failed in tuning.failed:
        errors.print(f"failed: trial {failed.slot}: {failed.message}", style="red", highlight=False)
    check = tuning.check
    rows = [[name, *(f"{value:.3f}" for value in figures), str(beyond)] for name, *figures, beyond in check.rows()]
    out.print(table(f"{len(check.given)} plants that the search has not seen [deg]", _COLUMNS, rows))
    low, high = check.interval()
    out.print(
        f"objective {100 * check.gain:.1f} % lower, 90 % interval over plants {100 * low:.1f} to {100 * high:.1f} %"
    )
    out.print(f"controller: {folder / 'controller.yaml'}")
    out.print(f"report: {folder / 'report.html'}")

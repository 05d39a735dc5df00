"""`hystmpc simulate`: every controller of a configuration along every motion on a simulated device."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.sim.compare import compare
from hystmpc.sim.config import load_simulation
from hystmpc.sim.results import StudyResult

from .console import bar, out, table

_COLUMNS = (
    "motion, controller",
    "RMSE",
    "max abs",
    "hold error",
    "hold p-p cmd",
    "travel cmd",
    "step ms",
    "p99 ms",
    "beyond limits",
)


def simulate(
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="A study: plant, model, motions, controllers (YAML).")
    ],
    folder: Annotated[Path, typer.Option("--out", help="Run folder to make; new or empty.")],
    overrides: Annotated[list[str] | None, typer.Option("--set", help="Change a setting: plant.lag_s=0.1.")] = None,
) -> None:
    """Simulate the closed loop and write run folder and report; Ctrl-C keeps the finished runs."""
    study = load_simulation(config, overrides or [])
    with bar("simulate") as show:
        result = compare(study, folder, lambda done, total: show(done, total=total))
    print_study(result)
    out.print(f"report: {folder / 'report.html'}")


def print_study(result: StudyResult) -> None:
    """The metrics of every run, in degrees, command units and milliseconds."""
    rows = []
    for run in result.results:
        m = run.metrics
        angles = (m.rmse_deg, m.max_abs_deg, m.hold_error_deg, m.hold_command_range, m.command_travel)
        times = (1e3 * m.step_mean_s, 1e3 * m.step_p99_s)
        figures = [f"{value:.3f}" for value in angles] + [f"{value:.2f}" for value in times]
        rows.append([f"{run.motion}, {run.controller}", *figures, str(m.limit_violations)])
    out.print(table("true tip angle against reference [deg]", _COLUMNS, rows))

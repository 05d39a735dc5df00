"""`hystmpc simulate`: every controller of a configuration along every motion on a simulated device."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.sim.compare import compare
from hystmpc.sim.config import load_simulation
from hystmpc.sim.results import Result, StudyResult

from .console import bar, out, table

_COLUMNS = ("controller", "RMSE", "max", "hold", "hold p-p", "step ms", "p99 ms", "beyond")


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
    """A table a motion.

    Angles in degrees, commands in their unit, times in milliseconds: error over the run, over the last halves of holds,
    greatest command range over one of those, time of a step, samples beyond a limit.
    """
    for motion in result.motions:
        rows = [_row(run) for run in result.of_motion(motion)]
        out.print(table(f"{motion}: true tip angle less reference [deg], command [{result.unit}]", _COLUMNS, rows))


def _row(run: Result) -> list[str]:
    m = run.metrics
    angles = (m.rmse_deg, m.max_abs_deg, m.hold_error_deg)
    times = (1e3 * m.step_mean_s, 1e3 * m.step_p99_s)
    figures = [f"{v:.3f}" for v in (*angles, m.hold_command_range)] + [f"{v:.1f}" for v in times]
    return [run.controller, *("-" if text == "nan" else text for text in figures), str(m.limit_violations)]

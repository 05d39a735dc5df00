"""`hystmpc simulate`: every controller along every motion on a simulated device; or thousands of such runs."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from hystmpc.sim.results import Result, StudyResult, approach_sentence, best_figures, conclusion
from hystmpc.tasks.simulate import reproduce, sweep
from hystmpc.tasks.simulate import simulate as simulate_study
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Progress

from .bars import progress_of
from .console import errors, out, table
from .options import AllowPython, Cluster, Overrides

DIFFERENT = 1

_COLUMNS = ("controller", "RMSE", "max", "hold", "hold p-p", "step ms", "p99 ms", "beyond")


def simulate(
    config: Annotated[
        Path | None, typer.Argument(metavar="[CONFIG]", help="A study: plant, model, motions, controllers (YAML).")
    ] = None,
    folder: Annotated[Path | None, typer.Option("--out", help="Run folder; new or empty, or a sweep to go on.")] = None,
    overrides: Overrides = None,
    controllers: Annotated[
        list[str] | None, typer.Option("--controller", help="Add a controller from a file: NAME=controller.yaml.")
    ] = None,
    many: Annotated[Path | None, typer.Option("--sweep", help="Many studies: grid, draws, seeds (YAML).")] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes of a sweep; else one a core.")] = None,
    cluster: Cluster = None,
    row: Annotated[
        tuple[Path, str] | None, typer.Option(metavar="DIR ID", help="Make one row of a sweep again and compare.")
    ] = None,
    allow: AllowPython = False,
) -> None:
    """Simulate the closed loop; write a run folder and its report.

    Ctrl-C keeps the finished runs.
    """
    _check(config, many, row, folder)
    _check_use(many, config, {"--jobs": jobs, "--cluster": cluster}, {"--controller": controllers or None})
    changes = overrides or ()
    if row is not None:
        _reproduce(row[0], row[1], folder)
    elif folder is not None and many is not None:
        _sweep(many, folder, {"overrides": changes, "jobs": jobs, "cluster": cluster, "allow_python": allow})
    elif folder is not None and config is not None:
        added = dict(map(_named, controllers or ()))
        show_study(
            "simulate",
            folder,
            lambda progress: simulate_study(
                config, folder, overrides=changes, controllers=added, allow_python=allow, progress=progress
            ),
        )


def _check(config: Path | None, sweep: Path | None, row: tuple[Path, str] | None, folder: Path | None) -> None:
    """One thing to do, and where to.

    Raises:
        ConfigError: if there is none or more than one, or no folder.
    """
    if sum(given is not None for given in (config, sweep, row)) != 1:
        raise ConfigError("simulate: expected one of CONFIG, --sweep FILE and --row DIR ID")
    if row is None and folder is None:
        raise ConfigError("simulate: no --out, expected a run folder")


def _check_use(
    sweep: Path | None, config: Path | None, of_sweep: Mapping[str, object], of_study: Mapping[str, object]
) -> None:
    """Options that would do nothing are no slip to pass over.

    Raises:
        ConfigError: if one is given for something else.
    """
    for given, options, place in ((sweep, of_sweep, "--sweep FILE"), (config, of_study, "CONFIG")):
        for name, value in options.items():
            if value is not None and given is None:
                raise ConfigError(f"simulate: {name} does nothing here, expected it with {place} only")


def _named(text: str) -> tuple[str, Path]:
    """Name and file of `NAME=FILE`.

    Raises:
        ConfigError: if it is not of that form.
    """
    name, separator, file = text.partition("=")
    if not separator or not name or "." in name:
        raise ConfigError(f"--controller {text}: expected NAME=FILE, a name without dots")
    return name, Path(file)


def show_study(title: str, folder: Path, run: Callable[[Progress], StudyResult]) -> None:
    """Do a study behind a bar and print its result; what Ctrl-C left of it is said too.

    Raises:
        ConfigError: if the folder is not new or empty, or the study cannot be run.
        typer.Exit: with 130 if the user ended it before a run was finished.
    """
    with progress_of(title, kept="interrupted before a run was finished: nothing is kept") as progress:
        result = run(progress)
    print_study(result)
    wanted, done = len(result.config.motions) * len(result.config.controllers), len(result.results)
    if done < wanted:
        errors.print(f"interrupted: {done} of {wanted} runs were finished and are kept", style="yellow")
    out.print(f"report: {folder / 'report.html'}", soft_wrap=True)


def _sweep(file: Path, folder: Path, options: Mapping[str, Any]) -> None:
    """Do what of a sweep is not done yet."""
    kept = f"interrupted: finished runs are kept in {folder}, the same command goes on"
    with progress_of("sweep", kept=kept) as progress:
        outcome = sweep(file, folder, **options, progress=progress)
    if outcome.failed:
        errors.print(f"failed: {outcome.failed} runs, the first: {outcome.message}", style="red")
    out.print(f"{outcome.rows} runs, {outcome.kept} of them from before, {outcome.failed} failed")
    if outcome.others:
        out.print(f"{outcome.others} more rows are of another form of this sweep: in the table, not in the report")
    out.print(f"table: {outcome.table}")
    out.print(f"report: {outcome.report}")


def _reproduce(folder: Path, identity: str, target: Path | None) -> None:
    """Make a row again; exit code 1 if a figure differs."""
    figures = reproduce(folder, identity, target)
    rows = [[f.name, str(f.before), str(f.again), "yes" if f.equal else "NO"] for f in figures]
    out.print(table(f"row {identity}", ("figure", "table", "again", "equal"), rows))
    if target is not None:
        out.print(f"report: {target / 'report.html'}")
    if not all(figure.equal for figure in figures):
        errors.print("the run came out otherwise: another version, machine or library?", style="red")
        raise typer.Exit(DIFFERENT)


def print_study(result: StudyResult) -> None:
    """A table a motion.

    Angles in degrees, commands in their unit, times in milliseconds: error over the run, over the last halves of holds,
    greatest command range over one of those, time of a step, samples beyond a limit. A star marks the least RMSE.
    """
    for motion in result.motions:
        runs = result.of_motion(motion)
        best = best_figures(runs)
        rows = [_row(run, best) for run in runs]
        out.print(table(f"{motion}: true tip angle less reference [deg], command [{result.unit}]", _COLUMNS, rows))
    for warning in result.warnings:
        errors.print(f"warning: {warning}", style="yellow", soft_wrap=True, highlight=False)
    for sentence in (conclusion(result), approach_sentence(result)):
        if sentence:
            out.print(sentence, soft_wrap=True, highlight=False)


def _row(run: Result, best: Container[tuple[str, str]]) -> list[str]:
    m = run.metrics
    rmse = f"{m.rmse_deg:.3f}{'*' if (run.controller, 'rmse_deg') in best else ' '}"
    others = (m.max_abs_deg, m.hold_error_deg, m.hold_command_range)
    times = (1e3 * m.step_mean_s, 1e3 * m.step_p99_s)
    figures = [f"{v:.3f}" for v in others] + [f"{v:.1f}" for v in times]
    return [run.controller, rmse, *("-" if text == "nan" else text for text in figures), str(m.limit_violations)]

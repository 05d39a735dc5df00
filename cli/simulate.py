"""`hystmpc simulate`: every controller along every motion on a simulated device; or thousands of such runs."""

from __future__ import annotations

import json
from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from hystmpc.sim.compare import compare
from hystmpc.sim.config import load_simulation
from hystmpc.sim.results import Result, StudyResult, approach_sentence, best_figures, conclusion
from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import require_resumable, require_vacant
from hystmpc.trials.types import Progress

from .bars import bar
from .console import INTERRUPTED, errors, out, table
from .options import AllowPython, heard, processes

DIFFERENT = 1

_COLUMNS = ("controller", "RMSE", "max", "hold", "hold p-p", "step ms", "p99 ms", "beyond")


def simulate(
    config: Annotated[
        Path | None, typer.Argument(metavar="[CONFIG]", help="A study: plant, model, motions, controllers (YAML).")
    ] = None,
    folder: Annotated[Path | None, typer.Option("--out", help="Run folder; new or empty, or a sweep to go on.")] = None,
    overrides: Annotated[list[str] | None, typer.Option("--set", help="Change a setting: plant.lag_s=0.1.")] = None,
    controllers: Annotated[
        list[str] | None, typer.Option("--controller", help="Add a controller from a file: NAME=controller.yaml.")
    ] = None,
    sweep: Annotated[Path | None, typer.Option(help="Many studies in one: grid, draws, seeds (YAML).")] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes of a sweep; else one a core.")] = None,
    cluster: Annotated[
        str | None, typer.Option(help="Dask scheduler of a sweep, tcp://host:8786; `local`: processes of this machine.")
    ] = None,
    row: Annotated[
        tuple[Path, str] | None, typer.Option(metavar="DIR ID", help="Make one row of a sweep again and compare.")
    ] = None,
    allow: AllowPython = False,
) -> None:
    """Simulate the closed loop; write a run folder and its report.

    Ctrl-C keeps the finished runs.
    """
    heard(allow)
    _check(config, sweep, row, folder)
    _check_use(sweep, config, {"--jobs": jobs, "--cluster": cluster}, {"--controller": controllers or None})
    if row is not None:
        _again(row[0], row[1], folder)
    elif folder is not None and sweep is not None:
        _sweep(sweep, overrides or [], folder, processes(jobs), cluster)
    elif folder is not None and config is not None:
        _study(config, [*map(_controller, controllers or []), *(overrides or [])], folder)


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


def _study(config: Path, overrides: Sequence[str], folder: Path) -> None:
    """One study."""
    study = load_simulation(config, overrides)
    show_study("simulate", folder, lambda progress: compare(study, folder, progress))


def show_study(title: str, folder: Path, run: Callable[[Progress], StudyResult]) -> None:
    """Do a study behind a bar and print what came of it; what Ctrl-C left of it is said too.

    Raises:
        ConfigError: if the folder is not new or empty, or the study cannot be run.
        typer.Exit: with 130 if the user ended it before a run was finished.
    """
    require_vacant(folder)
    try:
        with bar(title) as show:
            result = run(lambda done, total, note="": show(done, note, total=total))
    except KeyboardInterrupt:
        errors.print("interrupted before a run was finished: nothing is kept", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    print_study(result)
    wanted, done = len(result.config.motions) * len(result.config.controllers), len(result.results)
    if done < wanted:
        errors.print(f"interrupted: {done} of {wanted} runs were finished and are kept", style="yellow")
    out.print(f"report: {folder / 'report.html'}", soft_wrap=True)


def _sweep(file: Path, overrides: Sequence[str], folder: Path, jobs: int, cluster: str | None) -> None:
    """Do what of a sweep is not done yet."""
    from hystmpc.sim.jobs.runner import backend_for  # kept out of the way of the other verbs' start
    from hystmpc.sim.sweep.run import run_sweep
    from hystmpc.sim.sweep.settings import load_sweep

    settings = load_sweep(file, overrides)
    require_resumable(folder)
    backend = backend_for(jobs, cluster, str(folder))
    try:
        with bar("sweep") as show:
            found = run_sweep(
                settings, folder, backend, lambda done, total, note="": show(done, note, total=total), source=file
            )
    except KeyboardInterrupt:
        errors.print(f"interrupted: finished runs are kept in {folder}, the same command goes on", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    if found.failed:
        errors.print(f"failed: {found.failed} runs, the first: {found.message}", style="red")
    out.print(f"{found.rows} runs, {found.kept} of them from before, {found.failed} failed")
    if found.others:
        out.print(f"{found.others} more rows are of another form of this sweep: in the table, not in the report")
    out.print(f"table: {found.table}")
    out.print(f"report: {found.report}")


def _again(folder: Path, identity: str, target: Path | None) -> None:
    """Make a row again; exit code 1 if a figure differs."""
    from hystmpc.sim.sweep.run import reproduce

    if target is not None:
        require_vacant(target)
    figures = reproduce(folder, identity, target)
    rows = [[f.name, str(f.before), str(f.again), "yes" if f.equal else "NO"] for f in figures]
    out.print(table(f"row {identity}", ("figure", "table", "again", "equal"), rows))
    if target is not None:
        out.print(f"report: {target / 'report.html'}")
    if not all(figure.equal for figure in figures):
        errors.print("the run came out otherwise: another version, machine or library?", style="red")
        raise typer.Exit(DIFFERENT)


def _controller(text: str) -> str:
    """`NAME=FILE` as the override that puts the file's settings in.

    Raises:
        ConfigError: if it is not of that form, or the file holds no controller.
    """
    name, separator, file = text.partition("=")
    if not separator or not name or "." in name:
        raise ConfigError(f"--controller {text}: expected NAME=FILE, a name without dots")
    data = read_yaml(file)
    if not isinstance(data, dict) or "kind" not in data:
        raise ConfigError(f"{file}: expected the settings of one controller, with the key 'kind'")
    return f"controllers.{name}={json.dumps(data)}"


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

"""Subcommands of the simulated closed loop: `simulate` for a study or a sweep, `tune` and `demo`."""

from __future__ import annotations

from collections.abc import Container
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hystmpc.trials.errors import ConfigError

from .bars import progress_of
from .console import line, out, say, table
from .verb import OPTIONAL, Call, verb

if TYPE_CHECKING:
    from hystmpc.sim.results import Result, StudyResult
    from hystmpc.sim.sweep.run import SweepOutcome
    from hystmpc.sim.tuning.objective import Tuning

DIFFERENT = 1

_COLUMNS = ("controller", "RMSE", "max", "hold", "hold p-p", "step ms", "p99 ms", "beyond")
_JOBS = {**OPTIONAL, "help": "Processes of one thread each; one a core where left out."}
_NOTHING_KEPT = "interrupted before a run was finished: nothing is kept"


@verb(
    "simulate:simulate",
    "simulate:sweep",
    config={**OPTIONAL, "metavar": "[CONFIG]", "help": "A study: plant, model, motions, controllers (YAML)."},
    controllers={"flag": "--controller", "kind": list[str], "help": "Add a controller: NAME=controller.yaml."},
    out={**OPTIONAL, "help": "Run folder; new or empty, or a sweep to go on."},
    jobs=_JOBS,
)
def simulate(
    call: Call,
    many: Annotated[Path | None, typer.Option("--sweep", help="Many studies: grid, draws, seeds (YAML).")] = None,
    row: Annotated[
        tuple[Path, str] | None, typer.Option(metavar="DIR ID", help="Make one row of a sweep again and compare.")
    ] = None,
) -> None:
    """Ctrl-C ends the simulation; finished runs are kept.

    Raises:
        ConfigError: if there is not one thing to do, no folder, or an option that does nothing.
    """
    if sum(given is not None for given in (call.config, many, row)) != 1:
        raise ConfigError("simulate: expected one of CONFIG, --sweep FILE and --row DIR ID")
    if row is None and call.out is None:
        raise ConfigError("simulate: no --out, expected a run folder")
    if many is None and (call.jobs is not None or call.cluster is not None):
        name = "--cluster" if call.jobs is None else "--jobs"
        raise ConfigError(f"simulate: {name} does nothing here, expected it with --sweep FILE only")
    if call.config is None and call.controllers:
        raise ConfigError("simulate: --controller does nothing here, expected it with CONFIG only")
    if row is not None:
        _reproduce(*row, call.out)
    elif many is not None:
        _sweep(call, many)
    else:
        added = dict(map(_named, call.controllers))
        print_study(call.run("simulate", controllers=added, kept=_NOTHING_KEPT), call.out)


def _named(text: str) -> tuple[str, Path]:
    """Name and file of `NAME=FILE`; refuse any other form."""
    name, separator, file = text.partition("=")
    if not separator or not name or "." in name:
        raise ConfigError(f"--controller {text}: expected NAME=FILE, a name without dots")
    return name, Path(file)


def _sweep(call: Call, file: Path) -> None:
    kept = f"interrupted: finished runs are kept in {call.out}, the same command goes on"
    outcome: SweepOutcome = call.run("sweep", 1, config=file, kept=kept)
    if outcome.failed:
        say(f"failed: {outcome.failed} runs, the first: {outcome.message}", style="red")
    line(f"{outcome.rows} runs, {outcome.kept} of them from before, {outcome.failed} failed")
    if outcome.others:
        line(f"{outcome.others} more rows are of another form of this sweep: in the table, not in the report")
    line(f"table: {outcome.table}")
    line(f"report: {outcome.report}")


def _reproduce(folder: Path, identity: str, target: Path | None) -> None:
    from hystmpc.tasks.simulate import reproduce

    figures = reproduce(folder, identity, target)
    rows = [[f.name, str(f.before), str(f.repeated), "yes" if f.equal else "NO"] for f in figures]
    out.print(table(f"row {identity}", ("figure", "table", "again", "equal"), rows))
    if target is not None:
        line(f"report: {target / 'report.html'}")
    if not all(figure.equal for figure in figures):
        say("the run came out otherwise: another version, machine or library?", style="red")
        raise typer.Exit(DIFFERENT)


def print_study(result: StudyResult, folder: Path) -> None:
    """Print a table for each motion of a study, its conclusions, and the number of runs left by Ctrl-C.

    Angles in degrees, commands in their unit, times in milliseconds: error over the run, over the last halves of holds,
    greatest command range over one of those, time of a step, samples beyond a limit. A star marks the least RMSE.
    Of two axes the errors are distances in the plane, followed by the RMSE of x and of y; the mean time is left out.
    """
    from hystmpc.sim.results import approach_sentence, best_figures, conclusion

    for motion in result.motions:
        runs = result.of_motion(motion)
        best = best_figures(runs)
        rows, axes = [_row(run, best) for run in runs], "xy"[: len(runs[0].run.axis_rmse_deg)]
        columns = (*_COLUMNS[:2], *axes, *_COLUMNS[2:5], *_COLUMNS[6:]) if axes else _COLUMNS
        out.print(table(f"{motion}: true tip angle less reference [deg], command [{result.unit}]", columns, rows))
    for warning in result.warnings:
        say(f"warning: {warning}")
    for sentence in filter(None, (conclusion(result), approach_sentence(result))):
        line(sentence)
    wanted, done = len(result.config.motions) * len(result.config.controllers), len(result.results)
    if done < wanted:
        say(f"interrupted: {done} of {wanted} runs were finished and are kept")
    line(f"report: {folder / 'report.html'}")


def _row(run: Result, best: Container[tuple[str, str]]) -> list[str]:
    m = run.metrics
    rmse = f"{m.rmse_deg:.3f}{'*' if (run.controller, 'rmse_deg') in best else ' '}"
    others = (*run.run.axis_rmse_deg, m.max_abs_deg, m.hold_error_deg, m.hold_command_range)
    times = (*(() if run.run.axis_rmse_deg else (1e3 * m.step_mean_s,)), 1e3 * m.step_p99_s)
    figures = [f"{v:.3f}" for v in others] + [f"{v:.1f}" for v in times]
    return [run.controller, rmse, *("-" if text == "nan" else text for text in figures), str(m.limit_violations)]


def demo(
    folder: Annotated[Path, typer.Option("--out", help="Run folder to make; new or empty.")] = Path("demo"),
) -> None:
    """The motions are point-to-point and a scan, on the tendon catheter of the package."""
    from hystmpc.sim.compare import demo as run_demo

    with progress_of("demo", kept=_NOTHING_KEPT) as progress:
        result = run_demo(folder, progress)
    print_study(result, folder)


@verb("simulate:tune", config={"help": "A tuning: study, ranges, plants (YAML)."}, jobs=_JOBS)
def tune(call: Call) -> None:
    """The settings are verified on plants outside the search; controller.yaml and a report are written."""
    kept = f"interrupted: finished trials are kept in {call.out}, the same command goes on"
    tuning: Tuning = call.run("tune", kept=kept)
    for failed in tuning.failed:
        say(f"failed: trial {failed.slot}: {failed.message}", style="red")
    check = tuning.check
    rows = [[name, *(f"{value:.3f}" for value in figures), str(beyond)] for name, *figures, beyond in check.rows()]
    columns: tuple[str, ...] = ("settings", "objective", "mean error", "worst plant", "travel", "violations")
    if check.axes:  # two more columns have room beside short names
        columns = ("settings", "objective", "error", *check.axes, "worst", "travel", "beyond")
    out.print(table(f"{len(check.given)} plants that the search has not seen [deg]", columns, rows))
    low, high = check.interval()
    line(f"objective {100 * check.gain:.1f} % lower, 90 % interval over plants {100 * low:.1f} to {100 * high:.1f} %")
    line(f"controller: {call.out / 'controller.yaml'}")
    line(f"report: {call.out / 'report.html'}")

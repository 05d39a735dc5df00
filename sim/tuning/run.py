"""Execution of a tuning in a resumable run folder: search, check on held-out plants, controller file, report."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.trials.config import dump_yaml
from hystmpc.trials.csv_files import format_table
from hystmpc.trials.errors import ConfigError, FitError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.report import (
    COMMAND,
    MEASURED,
    MODEL,
    REFERENCE,
    Heading,
    KeyValues,
    Paragraph,
    Piece,
    Plot,
    Report,
    Table,
    new_figure,
)
from hystmpc.trials.run_folder import RunFolder, alone_in, resumed_folder
from hystmpc.trials.types import Progress, parts

from ..jobs import Backend, run_jobs
from ..sweep.report import plain_log
from .objective import SearchTrial, SlotOutcome, Tuning, held_out, loops_around, pareto_front
from .settings import TuneSettings, plain_controller

_REPORT_RUNS = 4  # runs of a plant that take as long as the report
_WAIT_S = 3.0  # time between two checks for trials of other processes


def run_tuning(
    settings: TuneSettings,
    out: Path | str,
    backend: Backend,
    storage: str | None = None,
    progress: Progress | None = None,
) -> Tuning:
    """Search, check, and write controller.yaml, study.yaml, trials.csv, held_out.csv and report.html to `out`.

    Args:
        settings: as of `complete`.
        out: a new or empty folder, or one of a tuning, whose trials are kept; one for each machine.
        storage: Optuna's URL of the search, such as `postgresql://...`, shared by machines; a file in `out` where left
            out.

    Raises:
        ConfigError: if the folder holds something else, the storage cannot be opened, workers die repeatedly, or optuna
            is not installed.
        FitError: if no trial was completed.
        KeyboardInterrupt: if the user ended it; finished trials are kept.
    """
    backend.check()
    if storage is not None:
        _optuna().open_search(storage, settings.search_name)  # before anything is written
    folder = _folder(Path(out), settings)
    runs = settings.trials * settings.plants.count, 2 * settings.held_out.count, _REPORT_RUNS
    searching, checking, reporting = parts(progress, runs)
    with alone_in(folder.path):
        url = storage or f"sqlite:///{(folder.path / 'search.db').resolve()}"
        trials, failed = search(settings, backend, url, searching)
        done = [trial for trial in trials if trial.state == "done"]
        if not done:
            reason = failed[0].message if failed else "all were pruned"
            raise FitError(f"{folder.path}: no trial came to an end ({reason})")
        best = min(done, key=lambda trial: (trial.value, trial.slot))
        check = held_out(settings, dict(best.values), backend, checking)
        tuning = Tuning(settings, trials, best, check, failed)
        reporting(0, 1, "writing the report")
        _write(folder, tuning)
        reporting(1, 1, "writing the report")
    return tuning


def search(
    settings: TuneSettings, backend: Backend, storage: str, progress: Progress | None = None
) -> tuple[tuple[SearchTrial, ...], tuple[SlotOutcome, ...]]:
    """Run the open trials, and wait for those of other processes."""
    optuna_ = _optuna()
    optuna_.open_search(storage, settings.search_name)  # before the workers open it
    slots: Sequence[int] = range(settings.trials)
    failed: list[SlotOutcome] = []
    ended = 0
    while slots:
        later = []
        for outcome in run_jobs(partial(optuna_.run_slot, settings, storage), slots, backend):
            if outcome.state == "elsewhere":
                later.append(outcome.slot)
                continue
            ended += 1
            failed += [outcome] if outcome.state == "failed" else []
            if progress:
                progress(ended, settings.trials, f"trial {outcome.slot} {outcome.state}")
        slots = sorted(later)
        if slots:
            time.sleep(_WAIT_S)
    return tuple(t for t in optuna_.trials_of(storage, settings.search_name) if t.slot < settings.trials), tuple(failed)


def _optuna() -> Any:
    """Import the module that needs Optuna; a `ConfigError` if it is not installed."""
    try:
        from . import optuna_
    except ModuleNotFoundError as error:
        raise ConfigError(f"tune: {error.name} is not installed: pip install 'hystmpc[tune]'") from None
    return optuna_


def _folder(path: Path, settings: TuneSettings) -> RunFolder:
    """Open a run folder, new or of an earlier tuning."""

    def refusal(before: Any) -> str:
        if not isinstance(before, dict) or "search" not in before:
            return "holds another kind of run, expected a new folder or that of a tuning"
        changed = _changed(TuneSettings.parse(before, str(path / "config.yaml")), settings)
        if not changed:
            return ""
        allowed = "only trials and held_out may change"
        return f"holds a tuning with other {', '.join(changed)}, expected a new folder; {allowed}"

    return resumed_folder(path, settings.model_dump(mode="json", exclude_none=True), settings.seed, refusal)


def _changed(before: TuneSettings, now: TuneSettings) -> list[str]:
    """Names of changed settings that invalidate the earlier trials of a search."""
    if before.fingerprint == now.fingerprint:
        return []
    old, new = before.model_dump(mode="json"), now.model_dump(mode="json")
    return [name for name in new if name not in ("trials", "held_out") and old[name] != new[name]]


def _write(folder: RunFolder, tuning: Tuning) -> None:
    settings, check = tuning.settings, tuning.check
    tuned = settings.with_values(dict(tuning.best.values))
    head = f"# Tuned by hystmpc over {settings.plants.count} plants: trial {tuning.best.slot} of {settings.trials}.\n"
    write_atomically(folder.path / "controller.yaml", head + dump_yaml(plain_controller(tuned, settings.study)))
    study = settings.study.model_copy(update={"controllers": {"given": settings.given, "tuned": tuned}})
    write_atomically(folder.path / "study.yaml", dump_yaml(study.model_dump(mode="json")))
    rows = [(t.slot, t.state, t.value, t.error_deg, t.travel, t.plants) for t in tuning.trials]
    names = ("slot", "state", "objective_deg", "error_deg", "travel", "plants")
    columns = {name: np.array(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)}
    columns |= {path: np.array([str(trial.values[path]) for trial in tuning.trials]) for path in settings.search}
    write_atomically(folder.path / "trials.csv", format_table(columns))
    write_atomically(folder.path / "held_out.csv", format_table(check.columns()))
    folder.write_report(tuning_report(tuning, folder.meta))


_PER_ROW = 3


def tuning_report(tuning: Tuning, meta: Mapping[str, Any]) -> Report:
    """Make the report of a tuning."""
    settings, check = tuning.settings, tuning.check
    low, high = check.interval()
    means = ("mean error [deg]", *(f"mean error {axis} [deg]" for axis in check.axes))
    columns = ("settings", "objective [deg]", *means, "worst plant [deg]", "travel", "plants with violations")
    verdict = (
        f"On {len(check.given)} plants that the search has not seen the objective falls by {100 * check.gain:.1f} % "
        f"(90 % interval over plants {100 * low:.1f} to {100 * high:.1f} %); {check.better} of them cost less."
    )
    pieces: list[Piece] = [
        Heading("Plants not seen"),
        Paragraph(verdict),
        Table(columns, check.rows(), "Error: RMSE of the true tip angle over all motions. Travel: over the need."),
        Plot(tuning.plot(), "Cost of every held-out plant; below the line the tuned settings win."),
        Heading("Settings found"),
        _values(tuning),
        Heading("Search"),
        KeyValues(_facts(tuning, meta)),
        Plot(_history(tuning.trials), "Every trial over the plants it has seen; line: best of the whole ones."),
        Heading("Error against effort"),
        Plot(_front(tuning.trials, tuning.best), "Trials that saw all plants; line: no other has both less."),
        _front_table(tuning),
        Heading("By setting"),
        Plot(_slices(tuning), "Objective over every searched setting; vertical: the setting taken."),
    ]
    given, tuned = settings.given, settings.with_values(dict(tuning.best.values))
    if not check.axes:  # the analysis of loops is of one axis
        loops = loops_around(settings, {"given": given, "tuned": tuned})
        pieces += [Heading("Loops around the model"), *loops.summary()]
    if tuning.failed:
        rows = [(outcome.slot, outcome.message) for outcome in tuning.failed]
        pieces.append(Table(("trial", "error"), rows, "Trials that raised; the same command tries them again."))
    return Report(f"Tuning of {settings.controller}", tuple(pieces), f"{settings.given.kind}, simulated plants")


def _facts(tuning: Tuning, meta: Mapping[str, Any]) -> dict[str, object]:
    settings, objective = tuning.settings, tuning.settings.objective
    pruned = sum(trial.state == "pruned" for trial in tuning.trials)
    return {
        "trials": f"{len(tuning.trials)} of {settings.trials}, {pruned} of them pruned",
        "plants": f"{settings.plants.count} to search on, {settings.held_out.count} held out",
        "drawn": ", ".join(settings.draw),
        "objective": f"{objective.mean:g} x mean + {objective.tail:g} x worst {100 * objective.tail_share:g} %",
        "penalties": f"{objective.violation_deg:g} deg for a violation, {objective.chatter_deg:g} deg per excess",
        "hystmpc": meta["versions"].get("hystmpc"),
        "started": meta["start"],
    }


def _values(tuning: Tuning) -> Table:
    given, rows = tuning.settings.given_values, []
    for path, value in tuning.best.values.items():
        ends = tuning.settings.search[path].ends
        rows.append((path, given[path], value, " to ".join(map(str, ends[:: max(1, len(ends) - 1)]))))
    return Table(("setting", "given", "tuned", "searched"), rows, f"Trial {tuning.best.slot}; controller.yaml has all.")


def _history(trials: tuple[SearchTrial, ...]) -> Figure:
    done = [trial for trial in trials if trial.state == "done"]
    pruned = [trial for trial in trials if trial.state == "pruned"]
    with new_figure(7.0, 2.8) as figure:
        axes: Axes = figure.subplots()
        axes.plot([t.slot for t in pruned], [t.value for t in pruned], "x", color=REFERENCE, ms=4, label="pruned")
        axes.plot([t.slot for t in done], [t.value for t in done], "o", color=MEASURED, ms=3.5, label="all plants")
        best = np.minimum.accumulate([t.value for t in done])
        axes.step([t.slot for t in done], best, where="post", color=MODEL, label="best")
        axes.set(xlabel="trial", ylabel="objective [deg]", yscale="log")
        plain_log(axes.yaxis)
        axes.legend()
    return figure


def _front(trials: tuple[SearchTrial, ...], best: SearchTrial) -> Figure:
    done, front = [t for t in trials if t.state == "done"], pareto_front(trials)
    with new_figure(5.0, 3.4) as figure:
        axes: Axes = figure.subplots()
        axes.plot([t.travel for t in done], [t.error_deg for t in done], "o", color=MEASURED, ms=3.5, alpha=0.6)
        axes.step([t.travel for t in front], [t.error_deg for t in front], where="pre", color=MODEL, lw=1.2)
        marks = [("given", t, COMMAND, "s") for t in done if t.slot == 0] + [("tuned", best, MODEL, "D")]
        for name, trial, colour, marker in marks:
            axes.plot(trial.travel, trial.error_deg, marker, color=colour, ms=7, label=name)
        axes.set(xlabel="command travel over the need", ylabel="robust error [deg]", xscale="log", yscale="log")
        plain_log(axes.xaxis)
        plain_log(axes.yaxis)
        axes.legend()
    return figure


def _front_table(tuning: Tuning) -> Table:
    paths = list(tuning.settings.search)
    rows = [(t.slot, t.error_deg, t.travel, *(t.values[path] for path in paths)) for t in pareto_front(tuning.trials)]
    return Table(("trial", "robust error [deg]", "travel", *paths), rows, "The front; `trials.csv` has all trials.")


def _slices(tuning: Tuning) -> Figure:
    paths = list(tuning.settings.search)
    done = [trial for trial in tuning.trials if trial.state == "done"]
    lines = -(-len(paths) // _PER_ROW)
    with new_figure(7.0, 0.3 + 1.9 * lines) as figure:
        grid = figure.subplots(lines, _PER_ROW, sharey=True, squeeze=False)
        for axes, path in zip(grid.ravel(), paths, strict=False):
            one = tuning.settings.search[path]
            value = (lambda v: v) if one.choice is None else str
            shown = [t for t in done if t.values[path] is not None]  # settings that were left out have no number
            axes.plot([value(t.values[path]) for t in shown], [t.value for t in shown], "o", color=MEASURED, ms=3)
            if tuning.best.values[path] is not None:
                axes.axvline(value(tuning.best.values[path]), color=MODEL, lw=1.0)
            axes.set_xlabel(path.rpartition(".")[2], fontsize=7.0)
            axes.set(yscale="log")
            plain_log(axes.yaxis)
            if one.log_uniform is not None:
                axes.set_xscale("log")
                plain_log(axes.xaxis)
        for axes in grid.ravel()[len(paths) :]:
            axes.remove()
        for row in grid:
            row[0].set_ylabel("objective [deg]")
    return figure

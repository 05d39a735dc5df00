"""The report of a tuning: what it brought on plants not seen, the search, and error against effort."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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

from ..sweep.report import plain_log
from ..sweep.settings import value_at
from .objective import SearchTrial, Tuning, pareto_front

_COLUMNS = ("settings", "objective [deg]", "mean error [deg]", "worst plant [deg]", "travel", "plants with violations")
_PER_ROW = 3


def tuning_report(found: Tuning, meta: Mapping[str, Any]) -> Report:
    """The page of a tuning."""
    settings, check = found.settings, found.check
    low, high = check.interval()
    verdict = (
        f"On {len(check.given)} plants that the search has not seen the objective falls by {100 * check.gain:.1f} % "
        f"(90 % interval over plants {100 * low:.1f} to {100 * high:.1f} %); {check.better} of them cost less."
    )
    pieces: list[Piece] = [
        Heading("Plants not seen"),
        Paragraph(verdict),
        Table(_COLUMNS, check.rows(), "Error: RMSE of the true tip angle over all motions. Travel: over the need."),
        Plot(found.plot(), "Cost of every held-out plant; below the line the tuned settings win."),
        Heading("Settings found"),
        _values(found),
        Heading("Search"),
        KeyValues(_facts(found, meta)),
        Plot(_history(found.trials), "Every trial over the plants it has seen; line: best of the whole ones."),
        Heading("Error against effort"),
        Plot(_front(found.trials, found.best), "Trials that saw all plants; line: no other has both less."),
        _front_table(found),
        Heading("By setting"),
        Plot(_slices(found), "Objective over every searched setting; vertical: the setting taken."),
    ]
    if found.failed:
        rows = [(outcome.slot, outcome.message) for outcome in found.failed]
        pieces.append(Table(("trial", "error"), rows, "Trials that raised; the same command tries them again."))
    return Report(f"Tuning of {settings.controller}", tuple(pieces), f"{settings.given.kind}, simulated plants")


def _facts(found: Tuning, meta: Mapping[str, Any]) -> dict[str, object]:
    settings, objective = found.settings, found.settings.objective
    pruned = sum(trial.state == "pruned" for trial in found.trials)
    return {
        "trials": f"{len(found.trials)} of {settings.trials}, {pruned} of them pruned",
        "plants": f"{settings.plants.count} to search on, {settings.held_out.count} held out",
        "drawn": ", ".join(settings.draw),
        "objective": f"{objective.mean:g} x mean + {objective.tail:g} x worst {100 * objective.tail_share:g} %",
        "penalties": f"{objective.violation_deg:g} deg for a violation, {objective.chatter_deg:g} deg per excess",
        "hystmpc": meta["versions"].get("hystmpc"),
        "started": meta["start"],
    }


def _values(found: Tuning) -> Table:
    given = found.settings.given.model_dump(mode="json")
    rows = []
    for path, value in found.best.values.items():
        one = found.settings.search[path]
        rows.append(
            (
                path,
                value_at(given, path),
                value,
                " to ".join(f"{end}" for end in one.ends[:: max(1, len(one.ends) - 1)]),
            )
        )
    return Table(("setting", "given", "tuned", "searched"), rows, f"Trial {found.best.slot}; controller.yaml has all.")


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


def _front_table(found: Tuning) -> Table:
    paths = list(found.settings.search)
    rows = [(t.slot, t.error_deg, t.travel, *(t.values[path] for path in paths)) for t in pareto_front(found.trials)]
    return Table(("trial", "robust error [deg]", "travel", *paths), rows, "The front; `trials.csv` has all trials.")


def _slices(found: Tuning) -> Figure:
    paths = list(found.settings.search)
    done = [trial for trial in found.trials if trial.state == "done"]
    lines = -(-len(paths) // _PER_ROW)
    with new_figure(7.0, 0.3 + 1.9 * lines) as figure:
        grid = figure.subplots(lines, _PER_ROW, sharey=True, squeeze=False)
        for axes, path in zip(grid.ravel(), paths, strict=False):
            one = found.settings.search[path]
            value = (lambda v: v) if one.choice is None else str
            shown = [t for t in done if t.values[path] is not None]  # settings that were left out have no number
            axes.plot([value(t.values[path]) for t in shown], [t.value for t in shown], "o", color=MEASURED, ms=3)
            if found.best.values[path] is not None:
                axes.axvline(value(found.best.values[path]), color=MODEL, lw=1.0)
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

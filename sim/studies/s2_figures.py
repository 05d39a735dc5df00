"""Figures 7 to 9 of S2: what the motion trained on does, errors by model, example trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.trials.report import ACCENTS, COMMAND, MEASURED, MODEL, REFERENCE, new_figure
from hystmpc.trials.trial import Trial

from .outcome import Outcome, title_of
from .result import JobResult
from .s2_plan import MOTIONS, split_tested_on
from .s2_views import MOTION_NAMES, UNITS, Matched

_DEVICE: Any = {"color": REFERENCE, "linewidth": 2.2, "alpha": 0.5}
_COLOURS = (MODEL, MEASURED, COMMAND, *ACCENTS)


def errors_figure(views: Sequence[Matched]) -> Figure:
    """Figure 8: mean and standard deviation of the RMSE as bar and line, the greatest error as a number above."""
    directions = list(dict.fromkeys(view.direction for view in views))
    with new_figure(7.0, 2.6 * len(directions)) as figure:
        grid = figure.subplots(len(directions), len(MOTIONS), squeeze=False)
        for axes in grid.ravel():
            axes.set_visible(False)
        for view in views:
            axes = grid[directions.index(view.direction)][MOTIONS.index(view.motion)]
            axes.set_visible(True)
            _bars(axes, view)
    return figure


def _bars(axes: Axes, view: Matched) -> None:
    unit, names = UNITS[view.direction], [title_of(kind) for kind in view.results]
    rmse = [view.errors(kind) for kind in view.results]
    means, spreads = [float(np.mean(e)) for e in rmse], [float(np.std(e)) for e in rmse]
    axes.bar(
        range(len(names)), means, yerr=spreads, color=MEASURED, width=0.7, error_kw={"elinewidth": 0.8, "capsize": 2}
    )
    top = max(mean + spread for mean, spread in zip(means, spreads, strict=True))
    for k, kind in enumerate(view.results):
        largest = float(np.max(view.errors(kind, "max_abs_error_deg")))
        axes.annotate(
            f"{largest:.2g}", (k, means[k] + spreads[k]), (0, 2), textcoords="offset points", ha="center", fontsize=7
        )
    axes.set_xticks(range(len(names)), names, rotation=45, ha="right")
    axes.set(ylabel=f"RMSE [{unit}]", title=f"{view.direction}, {MOTION_NAMES[view.motion]}", ylim=(0, 1.12 * top))
    axes.grid(visible=False, axis="x")


def training_motion_figure(outcome: Outcome, preset: str, kind: str = "lstm") -> Figure | None:
    """Figure 7: a network trained on either motion, on a trial of each; None if one of them is missing."""
    models = {motion: _trained_on(outcome, motion, preset, kind) for motion in MOTIONS}
    found = {MOTION_NAMES[motion]: result for motion, result in models.items() if result is not None}
    if len(found) < len(MOTIONS):
        return None
    with new_figure(7.0, 5.0) as figure:
        rows = figure.subplots(len(MOTIONS), 1)
        for axes, motion in zip(rows, MOTIONS, strict=True):
            trial = median_trial(outcome, motion, next(r for r in models.values() if r))
            axes.plot(trial.t, trial.angle, label="device", **_DEVICE)
            for (name, result), colour in zip(found.items(), _COLOURS, strict=False):
                axes.plot(trial.t, outcome.free_run(result.job, trial).theta, color=colour, label=f"trained on {name}")
            axes.set(ylabel="tip angle [deg]", title=f"{trial.source} ({MOTION_NAMES[motion]})")
        rows[-1].set_xlabel("time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _trained_on(outcome: Outcome, motion: str, preset: str, kind: str) -> JobResult | None:
    split = [split_tested_on(motion)]
    return outcome.better(split, stage="main", kind=kind, direction="forward", preset=preset, train=motion)


def median_trial(outcome: Outcome, motion: str, judge: JobResult) -> Trial:
    """The test trial on which the judge's error is the median: neither the best nor the worst example."""
    split = split_tested_on(motion)
    order = np.argsort(judge.figures("rmse_deg", [split]), kind="stable")
    return outcome.splits[split][int(order[len(order) // 2])]


def example_figure(views: Mapping[str, Matched], kinds: Sequence[str]) -> Figure | None:
    """Figure 9: models on one point-to-point trial, output above and error below, a column a direction."""
    shown = {d: [kind for kind in kinds if kind in view.results] for d, view in views.items()}
    if not any(shown.values()):
        return None
    with new_figure(7.0, 4.4) as figure:
        grid = figure.subplots(2, len(views), sharex="col", squeeze=False, height_ratios=(3, 2))
        first = next(iter(views.values()))
        trial = median_trial(first.outcome, first.motion, next(iter(first.results.values())))
        for column, (direction, view) in enumerate(views.items()):
            _example(grid[0][column], grid[1][column], view, shown[direction], trial)
        figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _example(above: Axes, below: Axes, view: Matched, kinds: Sequence[str], trial: Trial) -> None:
    outcome, unit = view.outcome, UNITS[view.direction]
    for kind, colour in zip(kinds, _COLOURS, strict=False):
        run = outcome.free_run(view.results[kind].job, trial)
        above.plot(trial.t, run.theta, color=colour, linewidth=0.9, label=title_of(kind))
        below.plot(trial.t, run.theta - run.trial.angle, color=colour, linewidth=0.8)
    above.plot(
        trial.t, trial.command if view.direction == "inverse" else trial.angle, zorder=0, label="device", **_DEVICE
    )
    below.axhline(0.0, color=REFERENCE, linewidth=0.6)
    what = "tip angle" if view.direction == "forward" else "displacement"
    above.set(title=f"{view.direction}: {trial.source}", ylabel=f"{what} [{unit}]")
    below.set(xlabel="time [s]", ylabel=f"error [{unit}]")

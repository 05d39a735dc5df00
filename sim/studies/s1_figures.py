"""Figures 4 and 5 of S1: the device's loops, and models on the four tests."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from hystmpc.trials.report import ACCENTS, COMMAND, MEASURED, MODEL, REFERENCE, new_figure

from .job import Splits
from .outcome import Outcome, title_of
from .result import JobResult
from .s1_plan import TESTS

_DEVICE: Any = {"color": REFERENCE, "linewidth": 2.2, "alpha": 0.5}
_COLOURS = (COMMAND, MODEL, MEASURED, *ACCENTS)
_LINE: Any = {"linewidth": 0.9}


def loops_figure(splits: Splits) -> Figure:
    """Figure 4: bending angle over pressure of the training groups."""
    groups = splits["train"]
    rows = -(-len(groups) // 4)
    with new_figure(7.0, 0.5 + 1.9 * rows) as figure:
        grid = figure.subplots(rows, 4, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, trial in zip(grid, groups, strict=False):
            axes.plot(trial.command, trial.angle, color=MEASURED, linewidth=0.6)
            axes.set_title(trial.source.rpartition("/")[2].removeprefix("train_"), fontsize=8)
        for axes in grid[len(groups) :]:
            axes.remove()
        figure.supxlabel(f"pressure [{groups[0].units.command}]", fontsize=9.0)
        figure.supylabel("bending angle [deg]", fontsize=9.0)
    return figure


def tracking_figure(outcome: Outcome, results: tuple[JobResult, ...]) -> Figure:
    """Figure 5: angle and error over time, a pair of axes for each test."""
    with new_figure(7.0, 7.5) as figure:
        grid = figure.subplots(4, 2, height_ratios=(3, 2, 3, 2))
        for k, (test, name) in enumerate(TESTS.items()):
            above, below = grid[2 * (k // 2)][k % 2], grid[2 * (k // 2) + 1][k % 2]
            trial = outcome.splits[test][0]
            above.plot(trial.t, trial.angle, label="device", **_DEVICE)
            for result, colour in zip(results, _COLOURS, strict=False):
                run = outcome.free_run(result.job, trial)
                above.plot(trial.t, run.theta, color=colour, label=title_of(result.job.kind), **_LINE)
                below.plot(trial.t, run.theta - trial.angle, color=colour, **_LINE)
            below.axhline(0.0, color=REFERENCE, linewidth=0.6)
            above.set(title=name, ylabel="angle [deg]")
            below.set(xlabel="time [s]", ylabel="error [deg]")
        figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure

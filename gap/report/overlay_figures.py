"""Real and simulated angle, over the command and over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hystmpc.trials.report import MODEL, new_figure

from .evidence import Stage, TrialEvidence
from .look import COLOUR, LABEL, QUIET, REAL, short, thin

_PER_LINE = 3
_LOOK: dict[Stage, Any] = {
    "nominal": {"color": COLOUR["nominal"], "linewidth": 0.9, "label": LABEL["nominal"]},
    "retuned": {"color": COLOUR["retuned"], "linewidth": 1.0, "label": LABEL["retuned"]},
    "with_effects": {"color": MODEL, "linewidth": 0.9, "linestyle": (0, (4, 1.5)), "label": LABEL["with_effects"]},
}


def loop_figure(trials: Sequence[TrialEvidence], unit: str, stages: Sequence[Stage]) -> Figure:
    """Loops of angle over command: real and of each simulator."""
    across = min(_PER_LINE, len(trials))
    lines = -(-len(trials) // across)
    with new_figure(7.0, 0.6 + (2.3 if across == _PER_LINE else 2.9) * lines) as figure:
        grid = figure.subplots(lines, across, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, trial in zip(grid, trials, strict=False):
            command, real, *runs = thin(trial.trial.command, trial.trial.angle, *_runs(trial, stages))
            axes.plot(command, real, **REAL)
            for stage, run in zip(stages, runs, strict=True):
                axes.plot(command, run, **_LOOK[stage])
            axes.set_title(short(trial.name, 30 if across == _PER_LINE else 46), fontsize=8.5)
        for axes in grid[len(trials) :]:
            axes.remove()
        for axes in grid[max(len(trials) - across, 0) : len(trials)]:
            axes.tick_params(labelbottom=True)
        figure.supxlabel(f"command [{unit}]", fontsize=9.0)
        figure.supylabel("tip angle [deg]", fontsize=9.0)
        figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def time_figure(trials: Sequence[TrialEvidence], stages: Sequence[Stage]) -> Figure:
    """Angle over time: real and of each simulator, and what the simulators leave of it."""
    with new_figure(7.0, 0.7 + 2.6 * len(trials)) as figure:
        rows = figure.subplots(2 * len(trials), 1, height_ratios=(5, 3) * len(trials))
        for angle, left, trial in zip(rows[::2], rows[1::2], trials, strict=True):
            t, real, *runs = thin(trial.trial.t - trial.trial.t[0], trial.trial.angle, *_runs(trial, stages))
            angle.plot(t, real, **REAL)
            for stage, run in zip(stages, runs, strict=True):
                angle.plot(t, run, **_LOOK[stage])
                left.plot(t, run - real, **{**_LOOK[stage], "linestyle": "-"})
            angle.set_title(short(trial.name, 60), fontsize=8.5)
            angle.set_ylabel("tip angle [deg]")
            angle.tick_params(labelbottom=False)
            left.axhline(0.0, **QUIET)
            left.set_ylabel("residual [deg]")
            left.sharex(angle)
        rows[-1].set_xlabel("time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _runs(trial: TrialEvidence, stages: Sequence[Stage]) -> list[NDArray[np.float64]]:
    return [getattr(trial, stage) for stage in stages]

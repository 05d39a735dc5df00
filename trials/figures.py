"""Figures common to several reports: closed loops over time, simulations with their error, loops over the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .figure_data import draw_long
from .report import REFERENCE, new_figure
from .types import Vec

Look = Mapping[str, Any]
"""Properties of a line: colour, width, dashes, label."""

REFERENCE_LOOK: Look = {"color": REFERENCE, "linewidth": 2.4, "alpha": 0.45, "label": "reference"}
ZERO_LOOK: Look = {"color": REFERENCE, "linewidth": 0.6}
LIMIT_LOOK: Look = {"color": REFERENCE, "linestyle": (0, (2, 4)), "linewidth": 0.8}
_ACROSS = 3  # panels in a line: a smaller loop is unreadable


@dataclass(frozen=True, eq=False)
class TrackedLine:
    """One closed loop along a motion."""

    t: Vec
    angle_deg: Vec
    lower: Vec  # command or error, (T,)
    look: Look


@dataclass(frozen=True, eq=False)
class TrackedMotion:
    """Closed loops along one motion."""

    t: Vec
    reference_deg: Vec  # (T,); not drawn if all of it is NaN
    lines: Sequence[TrackedLine]
    title: str = ""
    approach_s: float = 0.0  # end of the approach, which does not count [s]; shaded


def tracking_figure(
    motions: Sequence[TrackedMotion],
    lower_label: str,
    *,
    height: float = 4.4,
    limits: Sequence[float] = (),
    held: bool = False,
) -> Figure:
    """Draw reference and angles over time, above the command or the error, with a column for each motion."""
    drawn: Look = {"drawstyle": "steps-pre"} if held else {}
    with new_figure(7.0, height) as figure:
        rows = figure.subplots(2, len(motions), squeeze=False, sharex="col", sharey="row", height_ratios=(3, 2))
        rules: list[Line2D] = []
        for (upper, lower), motion in zip(rows.T, motions, strict=True):
            if np.isfinite(motion.reference_deg).any():
                draw_long(upper, motion.t, motion.reference_deg, **REFERENCE_LOOK)
            for line in motion.lines:
                draw_long(upper, line.t, line.angle_deg, **line.look)
                draw_long(lower, line.t, line.lower, **{**line.look, **drawn})
            if motion.approach_s:
                for axes in (upper, lower):
                    axes.axvspan(0.0, motion.approach_s, color=REFERENCE, alpha=0.12, linewidth=0.0)
            names = ["command limits", *["_"] * len(limits)]  # a legend names the first
            rules = [lower.axhline(edge, **LIMIT_LOOK, label=name) for edge, name in zip(limits, names, strict=False)]
            upper.set_title(motion.title)
            lower.set_xlabel("time [s]")
        rows[0, 0].set_ylabel("tip angle [deg]")
        rows[1, 0].set_ylabel(lower_label)
        entries = [*rows[0, 0].get_legend_handles_labels()[0], *rules[:1]]
        figure.legend(handles=entries, loc="outside upper center", ncols=4)
    return figure


@dataclass(frozen=True, eq=False)
class SimulatedTrial:
    """A recorded trial and simulations of it."""

    title: str
    t: Vec
    measured: tuple[Vec, Look]  # output and its look, (T,)
    runs: Sequence[tuple[Vec, Look]]  # simulated outputs and their looks, (T,)
    unit: str
    first: int = 0


def time_figure(trials: Sequence[SimulatedTrial], error: str = "residual") -> Figure:
    """Draw measured and simulated output of each trial over time, above simulation minus measurement."""
    with new_figure(7.0, 0.7 + 2.6 * len(trials)) as figure:
        rows = figure.subplots(2 * len(trials), 1, height_ratios=(5, 3) * len(trials))
        for upper, lower, trial in zip(rows[::2], rows[1::2], trials, strict=True):
            measured, look = trial.measured
            draw_long(upper, trial.t, measured, **look)
            for values, line in trial.runs:
                draw_long(upper, trial.t, values, **line)
                draw_long(lower, trial.t[trial.first :], (values - measured)[trial.first :], **line)
            upper.set_title(trial.title, fontsize=8.5)
            upper.set_ylabel(output_label(trial.unit))
            upper.tick_params(labelbottom=False)
            lower.axhline(0.0, **ZERO_LOOK)
            lower.set_ylabel(f"{error} [{trial.unit}]")
            lower.sharex(upper)
        rows[-1].set_xlabel("time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


@dataclass(frozen=True, eq=False)
class LoopPanel:
    """Outputs over one or several commands."""

    title: str
    curves: Sequence[tuple[Vec, Vec, Look]]  # command, output, (T,) each, and look


def loop_figure(
    panels: Sequence[LoopPanel], command_unit: str, output_unit: str, names: tuple[str, str] | None = None
) -> Figure:
    """Draw output over command, the hysteresis loop, with a panel for each trial or controller.

    Args:
        names: labels of both directions, on one scale: for two angles in place of command and output.
    """
    across = min(_ACROSS, len(panels))
    lines = -(-len(panels) // across)
    full = across == _ACROSS
    with new_figure(7.0, 0.6 + (2.3 if full else 2.9) * lines) as figure:
        grid = figure.subplots(lines, across, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, panel in zip(grid, panels, strict=False):
            for command, output, look in panel.curves:
                draw_long(axes, command, output, **look)
            axes.set_title(shortened(panel.title, 30 if full else 46), fontsize=8.5)
            if names is not None:
                axes.set_aspect("equal")
        for axes in grid[len(panels) :]:
            axes.remove()
        for axes in grid[max(len(panels) - across, 0) : len(panels)]:
            axes.tick_params(labelbottom=True)
        x, y = (f"command [{command_unit}]", output_label(output_unit)) if names is None else names
        figure.supxlabel(x, fontsize=9.0)
        figure.supylabel(y, fontsize=9.0)
        if entries := grid[0].get_legend_handles_labels()[0]:
            figure.legend(handles=entries, loc="outside upper center", ncols=3)
    return figure


def output_label(unit: str) -> str:
    """Label of an axis of the measured and simulated output."""
    return "tip angle [deg]" if unit == "deg" else f"output [{unit}]"


def shortened(name: str, most: int = 26) -> str:
    """Shorten a file name to at most `most` characters by leaving out its middle."""
    if len(name) <= most:
        return name
    head = (most - 1) // 2
    return f"{name[:head]}…{name[head + 1 - most :]}"

"""How far the gap shrinks: nominal, retuned, with effects, floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.trials.report import REFERENCE, new_figure

from ..diagnosis import Gap, Interval
from .evidence import Evidence, Stage, TrialEvidence
from .intervals import rmse_interval
from .look import COLOUR, INTERVAL, LABEL, MARKER, short, shown

MOST_ROWS = 10
_OFFSET = {"nominal": -0.22, "retuned": 0.0, "with_effects": 0.22}


def far_figure(evidence: Evidence) -> Figure:
    """RMSE of every final trial and of all together, with 90 % intervals, against the floor [deg]."""
    trials = shown(evidence.final, MOST_ROWS)
    gap, rows = evidence.diagnosis.gap, len(trials) + 1
    with new_figure(7.0, 1.1 + 0.42 * rows) as figure:
        axes: Axes = figure.subplots()
        for stage in evidence.stages:
            values = [_pooled(gap, stage), *(trial.rmse(stage) for trial in trials)]
            groups: list[Sequence[TrialEvidence]] = [evidence.final, *([trial] for trial in trials)]
            _points(axes, stage, values, [rmse_interval(group, stage) for group in groups])
        floors = [gap.floor_rmse_deg, *(trial.floor_deg for trial in trials)]
        axes.plot(floors, np.arange(rows), "|", color=REFERENCE, markersize=17, markeredgewidth=1.6, label="floor")
        names = [f"all {evidence.measured_on}", *(short(trial.name) for trial in trials)]
        axes.set_yticks(range(rows), names)
        axes.get_yticklabels()[0].set_fontweight("bold")
        axes.axhline(0.5, color=REFERENCE, linewidth=0.6)
        axes.set(ylim=(rows - 0.5, -0.5), xlabel="RMSE of simulated less measured angle [deg]")
        axes.set_xlim(left=0.0)
        axes.grid(visible=False, axis="y")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def _points(axes: Axes, stage: Stage, values: list[float], intervals: list[Interval | None]) -> None:
    """One stage's values, one a row, each with its interval."""
    rows = np.arange(len(values)) + _OFFSET[stage]
    for row, value, interval in zip(rows, values, intervals, strict=True):
        if interval is not None and np.isfinite(value):
            reach = [[max(value - interval[0], 0.0)], [max(interval[1] - value, 0.0)]]
            axes.errorbar(value, row, xerr=reach, zorder=2, **{**INTERVAL, "color": COLOUR[stage]})
    style: Any = {"color": COLOUR[stage], "marker": MARKER[stage], "linestyle": "none", "markersize": 5.5}
    axes.plot(values, rows, label=LABEL[stage], zorder=3, **style)


def _pooled(gap: Gap, stage: Stage) -> float:
    return float(getattr(gap, f"{stage}_rmse_deg"))

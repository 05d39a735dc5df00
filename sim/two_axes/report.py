"""Report of a closed-loop study of two axes: both angles and the commands over time, set-up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.trials.figure_data import draw_long
from hystmpc.trials.figures import LIMIT_LOOK, REFERENCE_LOOK
from hystmpc.trials.report import REFERENCE, new_figure

from ..results import Result
from .config import TwoAxisSimulationConfig

Looks = Mapping[str, Mapping[str, Any]]


def signals_figure(results: Sequence[Result], look: Looks, unit: str) -> Figure:
    """Draw both angles and every command over time, of all controllers along one motion."""
    run, limits = results[0].run, results[0].limits
    with new_figure(7.0, 6.4) as figure:
        rows: Sequence[Axes] = figure.subplots(4, 1, sharex=True)
        for i, axes in enumerate(rows[:2]):
            draw_long(axes, run.log.time_s, run.log.reference_deg[:, i], **REFERENCE_LOOK)
            for result in results:
                line = {**look[result.controller], "linewidth": 1.0, "label": result.controller}
                draw_long(axes, result.run.log.time_s, result.run.true_deg[:, i], **line)
            axes.set_ylabel(f"angle {'xy'[i]} [deg]")
        for k, (axes, name) in enumerate(zip(rows[2:], "xy", strict=True)):
            for result in results:
                line = {**look[result.controller], "linewidth": 0.9, "drawstyle": "steps-pre"}
                draw_long(axes, result.run.log.time_s, result.run.log.command[:, k], **line)
            one = limits[k] if isinstance(limits, tuple) else limits
            for edge in (one.lower, one.upper):
                axes.axhline(edge, **LIMIT_LOOK)
            axes.set_ylabel(f"command {name} [{unit}]")
        for axes in rows:
            if run.first:
                axes.axvspan(0.0, run.first * run.dt, color=REFERENCE, alpha=0.12, linewidth=0.0)
        rows[-1].set_xlabel("time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def set_up_rows(config: TwoAxisSimulationConfig, unit: str) -> dict[str, object]:
    """Names and values of plant and limits, for the table of the set-up."""
    plant = config.plant.model_dump(exclude={"simulator"}, exclude_defaults=True)
    rows: dict[str, object] = {"changes of the plant": ", ".join(f"{k} {v}" for k, v in plant.items()) or "none"}
    for name, one in zip("xy", config.command_limits(), strict=True):
        rows[f"limits of command {name}"] = f"{one.lower:g} to {one.upper:g} {unit}, {one.rate:.4g} {unit}/s"
    return rows

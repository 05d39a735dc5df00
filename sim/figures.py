"""Figures of a closed-loop study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.trials.report import PALETTE, REFERENCE, new_figure

from .results import Result

_LIMIT: Any = {"color": REFERENCE, "linestyle": (0, (4, 3)), "linewidth": 0.7}
_WANTED: Any = {"color": REFERENCE, "linewidth": 2.4, "alpha": 0.45}
_BINS = 61
_ROWS = 3  # a loop plot smaller than a third of the width cannot be read


def colours(controllers: Sequence[str]) -> dict[str, str]:
    """One colour for each controller, the same in every figure of a study."""
    return {name: PALETTE[k % (len(PALETTE) - 1)] for k, name in enumerate(controllers)}


def tracking_figure(results: Sequence[Result], colour: Mapping[str, str], unit: str) -> Figure:
    """Angle and command over time, with reference and command limits."""
    with new_figure(7.0, 5.0) as figure:
        angle, command = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        first = results[0]
        angle.plot(first.run.log.time_s, first.run.log.reference_deg, label="reference", **_WANTED)
        for result in results:
            t, style = result.run.log.time_s, {"color": colour[result.controller], "linewidth": 0.9}
            angle.plot(t, result.run.true_deg, label=result.controller, **style)
            command.step(t, result.run.log.command, where="pre", **style)
        for edge in {edge for result in results for edge in (result.limits.lower, result.limits.upper)}:
            command.axhline(edge, **_LIMIT)
        angle.set_ylabel("tip angle [deg]")
        command.set(xlabel="time [s]", ylabel=f"command [{unit}]")
        figure.legend(*angle.get_legend_handles_labels(), loc="outside upper center", ncols=6)
    return figure


def error_figure(results: Sequence[Result], colour: Mapping[str, str]) -> Figure:
    """Error over time, one row for each controller on one scale."""
    with new_figure(7.0, 0.8 + 0.8 * len(results)) as figure:
        rows = figure.subplots(len(results), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axes, result in zip(rows, results, strict=True):
            t, error = result.run.log.time_s, result.run.error_deg
            axes.fill_between(t, error, color=colour[result.controller], linewidth=0.0)
            axes.axhline(0.0, color=REFERENCE, linewidth=0.6)
            axes.set_title(f"{result.controller}: RMSE {result.metrics.rmse_deg:.2f} deg")
        figure.supylabel("error [deg]", fontsize=9.0)
        rows[-1].set_xlabel("time [s]")
    return figure


def loop_figure(results: Sequence[Result], colour: Mapping[str, str], unit: str) -> Figure:
    """Angle over command: the hysteresis that each controller went through."""
    lines = -(-len(results) // _ROWS)
    with new_figure(7.0, 0.4 + 2.1 * lines) as figure:
        grid = figure.subplots(lines, _ROWS, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, result in zip(grid, results, strict=False):
            axes.plot(result.run.log.command, result.run.true_deg, color=colour[result.controller], linewidth=0.8)
            axes.set_title(result.controller)
        for axes in grid[len(results) :]:
            axes.remove()
        figure.supxlabel(f"command [{unit}]", fontsize=9.0)
        figure.supylabel("tip angle [deg]", fontsize=9.0)
        for axes in grid[max(len(results) - _ROWS, 0) : len(results)]:
            axes.tick_params(labelbottom=True)
    return figure


def histogram_figure(results: Sequence[Result], colour: Mapping[str, str]) -> Figure:
    """Share of samples by error; the outermost bins hold what lies beyond them."""
    errors = [result.run.error_deg for result in results]
    reach = float(np.quantile(np.abs(np.concatenate(errors)), 0.995))
    edges = np.linspace(-reach, reach, _BINS)
    with new_figure(7.0, 2.8) as figure:
        axes: Axes = figure.subplots()
        for result, error in zip(results, errors, strict=True):
            share = np.histogram(np.clip(error, -reach, reach), edges)[0] / error.size
            axes.stairs(100 * share, edges, color=colour[result.controller], label=result.controller, linewidth=1.2)
        axes.set(xlabel="error [deg]", ylabel="samples [%]", xlim=(-reach, reach))
        axes.legend()
    return figure


def timing_figure(results: Sequence[Result], colour: Mapping[str, str], dt_s: float) -> Figure:
    """Execution time a stage over all runs: bar to the median, line to the 99th percentile; dashed the sample time."""
    rows = _stage_times(results)
    with new_figure(7.0, 0.9 + 0.2 * len(rows)) as figure:
        axes: Axes = figure.subplots()
        for k, (controller, _, seconds) in enumerate(rows):
            median, slow = 1e3 * np.median(seconds), 1e3 * np.quantile(seconds, 0.99)
            axes.barh(k, median, height=0.7, color=colour[controller])
            axes.plot((median, slow), (k, k), color=REFERENCE, linewidth=0.9)
            axes.plot(slow, k, color=REFERENCE, marker="|", markersize=6)
        axes.axvline(1e3 * dt_s, **_LIMIT)
        axes.set(xscale="log", xlabel="execution time [ms]", ylim=(len(rows) - 0.4, -0.6))
        axes.set_yticks(range(len(rows)), [f"{controller}: {stage}" for controller, stage, _ in rows])
        axes.grid(visible=False, axis="y")
    return figure


def _stage_times(results: Sequence[Result]) -> list[tuple[str, str, Any]]:
    """Controller, stage and times [s] of the samples in which the stage ran; all stages together come last."""
    rows: list[tuple[str, str, Any]] = []
    for controller in dict.fromkeys(result.controller for result in results):
        logs = [result.run.log for result in results if result.controller == controller]
        for stage in dict.fromkeys(stage for log in logs for stage in log.stage_s):
            times = np.concatenate([log.stage_s[stage] for log in logs if stage in log.stage_s])
            if np.any(times > 0):
                rows.append((controller, stage, times[times > 0]))
        rows.append((controller, "whole step", np.concatenate([log.step_s for log in logs])))
    return rows

"""Figures of the benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hystmpc.trials.report import COMMAND, MEASURED, MODEL, PALETTE, REFERENCE, new_figure

from .control_outcome import ControlOutcome
from .control_result import ControlResult, load_signals
from .control_rivals import CONTROLLERS, ORACLE

_MARKS = "osD^vP"
_WANTED: Any = {"color": REFERENCE, "linewidth": 2.4, "alpha": 0.45}


def rmse_figure(outcome: ControlOutcome, rate_hz: float) -> Figure:
    """RMSE of every run, a panel for each plant: a row for each controller, a mark for each motion."""
    plants = [plant for plant, rate in outcome.loops if rate == rate_hz]
    names = [name for name in outcome.settings.controllers if CONTROLLERS[name].usable_at(rate_hz)]
    lines = -(-len(plants) // 2)
    with new_figure(7.0, 0.7 + lines * (0.7 + 0.17 * len(names))) as figure:
        grid = figure.subplots(lines, 2, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, plant in zip(grid, plants, strict=False):
            for k, motion in enumerate(outcome.settings.motions):
                runs = [outcome.by_name.get((plant, rate_hz, name, motion)) for name in names]
                x = [run.figures["rmse_deg"] if run else np.nan for run in runs]
                style: Any = {"linestyle": "none", "marker": _MARKS[k % len(_MARKS)], "markersize": 4.0}
                axes.plot(x, range(len(names)), color=PALETTE[k % len(PALETTE)], label=motion, alpha=0.85, **style)
            axes.set(xscale="log", title=plant, ylim=(len(names) - 0.5, -0.5))
            axes.set_yticks(range(len(names)), names)
        for axes in grid[len(plants) :]:
            axes.remove()
        figure.supxlabel("RMSE of the true angle [deg]", fontsize=9.0)
        figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def motion_figure(outcome: ControlOutcome, plant: str, rate_hz: float, motion: str) -> Figure | None:
    """Angle, error and command along one motion: the oracle, the best baseline and the best predictive controllers."""
    runs = _chosen(outcome, plant, rate_hz, motion)
    if not runs:
        return None
    colour = _colours(runs)
    with new_figure(7.0, 5.4) as figure:
        angle, error, command = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
        for k, run in enumerate(runs):
            signals = load_signals(outcome.folder, run.job)
            t, reference = signals["time_s"], signals["reference_deg"]
            if k == 0:
                angle.plot(t, reference, label="reference", **_WANTED)
            style: Any = {"color": colour[run.job.subject], "linewidth": 0.9}
            angle.plot(t, signals["true_deg"], label=run.job.subject, **style)
            error.plot(t, signals["true_deg"] - reference, **style)
            command.step(t, signals["command"], where="pre", **style)
        error.axhline(0.0, color=REFERENCE, linewidth=0.6)
        angle.set_ylabel("tip angle [deg]")
        error.set_ylabel("error [deg]")
        command.set(xlabel="time [s]", ylabel="command [mm]")
        figure.legend(*angle.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def _chosen(outcome: ControlOutcome, plant: str, rate_hz: float, motion: str) -> Sequence[ControlResult]:
    """The best baseline, the best controller of each predictive kind, and the oracle."""
    here = [run for run in outcome.runs if (run.job.plant, run.job.rate_hz, run.job.motion) == (plant, rate_hz, motion)]
    groups: dict[str, ControlResult] = {}
    for run in sorted(here, key=lambda run: run.figures["rmse_deg"]):
        rival = CONTROLLERS[run.job.subject]
        if rival.oracle and rival.name != ORACLE:
            continue
        group = "oracle" if rival.oracle else rival.kind if rival.predictive else "baseline"
        groups.setdefault(group, run)
    order = ("baseline", "linearised_mpc", "sampling_mpc", "oracle")
    return [groups[name] for name in order if name in groups]


def _colours(runs: Sequence[ControlResult]) -> Mapping[str, str]:
    known = (PALETTE[5], MEASURED, MODEL, COMMAND)
    return {run.job.subject: known[k % len(known)] for k, run in enumerate(runs)}

"""Where in the motion's parts, in command, angle and speed, and in frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.trials.report import MEASURED, REFERENCE, new_figure

from ..diagnosis import Place
from ..spectrum import Line
from .derived import amplitude_density, binned
from .evidence import Stage, TrialEvidence
from .look import COLOUR, INTERVAL, LABEL, QUIET, plain

_BAR = COLOUR["retuned"]


def share_figure(places: Mapping[str, Place]) -> Figure:
    """Share of the retuned residual's energy in each part of the motion, beside the share of time spent there."""
    ordered = sorted(places.items(), key=lambda item: -item[1].share)
    with new_figure(7.0, 0.95 + 0.3 * len(ordered)) as figure:
        axes: Axes = figure.subplots()
        for k, (_, place) in enumerate(ordered):
            axes.barh(k, place.share, height=0.6, color=_BAR, label="share of the residual's energy" if not k else None)
            low, high = place.ci90
            reach = [[max(place.share - low, 0.0)], [max(high - place.share, 0.0)]]
            axes.errorbar(place.share, k, xerr=reach, label="90 % interval" if not k else None, **INTERVAL)
            if place.density > 0:
                time = place.share / place.density
                label = "share of time" if not k else None
                axes.plot(time, k, "|", color="#222222", markersize=15, markeredgewidth=1.8, label=label)
            text = f"{place.density:.1f} x average"
            axes.annotate(text, (1.01, k), xycoords=("axes fraction", "data"), va="center", fontsize=8)
        axes.set_yticks(range(len(ordered)), [plain(name) for name, _ in ordered])
        axes.set(ylim=(len(ordered) - 0.5, -0.6), xlabel="share")
        axes.set_xlim(0.0, min(1.0, 1.08 * max(max(place.ci90[1], place.share) for place in places.values())))
        axes.grid(visible=False, axis="y")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def bins_figure(trials: Sequence[TrialEvidence], stages: Sequence[Stage]) -> Figure | None:
    """RMSE over command, angle and speed, of each simulator; None where nothing moves."""
    groups = binned(trials, stages)
    if not groups:
        return None
    with new_figure(7.0, 2.8) as figure:
        rows = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
        for axes, group in zip(rows, groups, strict=True):
            for stage, values in group.rmse_deg.items():
                axes.stairs(values, group.edges, color=COLOUR[stage], label=LABEL[stage], linewidth=1.5, baseline=None)
            shares = axes.twinx()
            shares.stairs(group.time, group.edges, fill=True, color="#e2e2e2", zorder=0)
            shares.set(ylim=(0.0, 1.0), yticks=())
            shares.spines["right"].set_visible(False)
            axes.set_zorder(shares.get_zorder() + 1)
            axes.patch.set_visible(False)
            axes.set_xlabel(f"{group.quantity} [{group.unit}]")
        rows[0].set_ylabel("RMSE [deg]")
        rows[0].set_ylim(bottom=0.0)
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def spectrum_figure(
    trials: Sequence[TrialEvidence], stages: Sequence[Stage], noise_deg: float, lines: Sequence[Line] = ()
) -> Figure:
    """Residual over frequency against white noise of that deviation; lines that are not the command's are marked."""
    with new_figure(7.0, 2.8) as figure:
        axes: Axes = figure.subplots()
        top = 0.0
        for stage in stages:
            frequency, density = amplitude_density(trials, stage)
            axes.plot(frequency[1:], density[1:], color=COLOUR[stage], label=LABEL[stage])
            top = float(frequency[-1])
        if np.isfinite(noise_deg) and noise_deg > 0 and top > 0:
            level = noise_deg * np.sqrt(1 / top)  # one-sided, up to the Nyquist frequency
            axes.axhline(level, color=REFERENCE, linestyle=(0, (4, 3)), linewidth=0.9, label="noise")
        for k, line in enumerate(lines):
            label = "not the command's" if not k else None
            axes.axvline(line.hz, color=MEASURED, linestyle=(0, (1, 2)), linewidth=1.2, label=label)
        axes.set(xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel="residual [deg/√Hz]")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def memory_figure(gains: Mapping[str, float]) -> Figure:
    """What of the residual each memory of the command predicts on trials left out."""
    ordered = sorted(gains.items(), key=lambda item: -item[1])
    with new_figure(7.0, 0.7 + 0.25 * len(ordered)) as figure:
        axes: Axes = figure.subplots()
        axes.barh(range(len(ordered)), [gain for _, gain in ordered], height=0.6, color=_BAR)
        axes.set_yticks(range(len(ordered)), [plain(name) for name, _ in ordered])
        axes.axvline(0.0, **QUIET)
        axes.set(ylim=(len(ordered) - 0.5, -0.5), xlabel="share of the residual's energy explained on trials left out")
        axes.grid(visible=False, axis="y")
    return figure

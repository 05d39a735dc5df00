"""The growth of a step's time as one figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from .report import Growth

_LABELS = {"H": "horizon H [samples]", "N": "plans N", "hidden": "cells in each of two layers"}


def growth_figure(series: Sequence[Growth]) -> Figure:
    """Median and 99th percentile of a step over each size, both axes logarithmic, with the exponent at the end."""
    figure = Figure(figsize=(4.0 * len(series), 3.4), layout="constrained")
    for axes, one in zip(figure.subplots(1, len(series), squeeze=False)[0], series, strict=True):
        median, p99, least = ([1e3 * getattr(t, name) for t in one.times] for name in ("median_s", "p99_s", "least_s"))
        axes.loglog(one.values, p99, color="0.7", marker=".", label="p99")
        axes.loglog(one.values, median, color="tab:blue", marker="o", label="median")
        axes.loglog(one.values, least, color="tab:blue", linestyle=":", label="shortest")
        axes.set_title(f"{one.what}: {one.size}^{one.exponent:.2f} at the end")
        axes.set_xlabel(_LABELS[one.size])
        axes.set_ylabel("step [ms]")
        axes.set_xticks(one.values, [str(v) for v in one.values])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    figure.axes[0].legend(frameon=False)
    return figure


def save_growth(series: Sequence[Growth], folder: Path) -> None:
    """growth.svg and growth.png in `folder`; nothing where there is no series."""
    if series:
        figure = growth_figure(series)
        for name in ("growth.svg", "growth.png"):
            figure.savefig(folder / name, dpi=150)

"""Figures of a blind check's report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from hystmpc.trials.report import MEASURED, MODEL, REFERENCE, new_figure

from .measures import Calibration, Confusion, Rate
from .plan import confusable


def confusion_figure(confusion: Confusion) -> Figure:
    """Truth by answer: shade by the share of the truth's cases, counts inside; frames mark confusable pairs."""
    counts = confusion.counts
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    rows, columns = counts.shape
    with new_figure(2.4 + 0.42 * columns, 1.9 + 0.32 * rows) as figure:
        axes = figure.add_subplot()
        axes.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
        for r, truth in enumerate(confusion.truths):
            for c, guess in enumerate(confusion.guesses):
                if truth != guess and confusable(truth, guess):
                    axes.add_patch(_frame(c, r))
                if counts[r, c]:
                    ink = "white" if share[r, c] > 0.6 else "#222222"
                    axes.text(c, r, str(counts[r, c]), ha="center", va="center", color=ink, fontsize=8)
        axes.set_xticks(range(columns), confusion.guesses, rotation=45, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(rows), confusion.truths)
        axes.grid(False)
        axes.set_xlabel("answer")
        axes.set_ylabel("truth")
    return figure


def _frame(column: int, row: int) -> Rectangle:
    return Rectangle((column - 0.46, row - 0.44), 0.92, 0.88, fill=False, edgecolor=MODEL, linewidth=0.8)


def rates_figure(tables: Sequence[tuple[str, dict[str, Rate]]]) -> Figure:
    """Shares of right verdicts with 90 % intervals, one panel a table."""
    widths = [max(len(rows), 2) for _, rows in tables]
    with new_figure(1.0 + 0.55 * sum(widths), 3.0) as figure:
        panels = figure.subplots(1, len(tables), sharey=True, squeeze=False, width_ratios=widths)[0]
        for axes, (title, rows) in zip(panels, tables, strict=True):
            for k, found in enumerate(rows.values()):
                low, high = found.ci90
                axes.plot([k, k], [low, high], color=MEASURED, linewidth=1.2)
                axes.plot([k], [found.value], "o", color=MEASURED, markersize=5)
                axes.annotate(str(found.cases), (k, -0.08), ha="center", fontsize=7, color=REFERENCE)
            axes.set_xticks(range(len(rows)), list(rows), rotation=45, ha="right", rotation_mode="anchor")
            axes.set_xlim(-0.6, len(rows) - 0.4)
            axes.set_ylim(-0.11, 1.05)
            axes.set_title(title)
        panels[0].set_ylabel("share of right verdicts")
    return figure


def calibration_figure(found: Calibration) -> Figure:
    """Share of true names over their probability, by bin; area by the number of names."""
    with new_figure(3.6, 3.4) as figure:
        axes = figure.add_subplot()
        axes.plot([0, 1], [0, 1], color=REFERENCE, linewidth=0.8, linestyle="--")
        for part in found.bins:
            axes.scatter([part.confidence], [part.right], s=20 + 6 * part.claims, color=MEASURED, alpha=0.7)
            axes.annotate(str(part.claims), (part.confidence, part.right), ha="center", va="center", fontsize=7)
        axes.set_xlim(-0.03, 1.03)
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlabel("probability that was given")
        axes.set_ylabel("share that was true")
    return figure


def closed_figure(points: Sequence[tuple[float, float, bool]]) -> Figure:
    """Closed share that was claimed over the true one; filled where the truth was named."""
    with new_figure(3.6, 3.4) as figure:
        axes = figure.add_subplot()
        axes.plot([0, 1], [0, 1], color=REFERENCE, linewidth=0.8, linestyle="--")
        for true, said, right in points:
            colour = MEASURED if right else MODEL
            axes.plot([true], [max(said, -0.05)], "o", color=colour, markerfacecolor=colour if right else "none")
        axes.set_xlim(-0.03, 1.03)
        axes.set_ylim(-0.08, 1.08)
        axes.set_xlabel("true closed share")
        axes.set_ylabel("closed share that was claimed")
    return figure

"""Page of a blind check's score, with its figures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from hystmpc.models.effects.catalogue import confusable
from hystmpc.trials.report import MEASURED, MODEL, REFERENCE, Heading, Paragraph, Piece, Plot, Report, Table, new_figure

from ..page import Bar, Rate
from .bars import Calibration, Confusion, true_share
from .score import Score, miss_json

BAR_COLUMNS = ("measure", "number", "90 % interval", "goal", "cases", "state")


def confusion_figure(confusion: Confusion) -> Figure:
    """Confusion matrix: shade by the share of the truth's cases, counts inside; frames mark confusable pairs."""
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


def bars_plot(score: Score) -> Plot:
    """Plot of each requirement: its value and 90 % interval, and its target range in grey; shares and means in 0..1."""
    shown = [bar for bar in score.bars if bar.state != "not measured"][::-1]
    with new_figure(7.5, 0.9 + 0.27 * max(len(shown), 1)) as figure:
        axes = figure.add_subplot()
        for k, bar in enumerate(shown):
            low, high = bar.wanted
            axes.barh(k, max(high - low, 0.008), left=low - 0.004 * (low == high), height=0.8, color="#dddddd")
            colour = MEASURED if bar.state == "met" else MODEL
            if bar.ci90:
                axes.plot(bar.ci90, [k, k], color=colour, linewidth=1.2)
            axes.plot([bar.value], [k], "o", color=colour, markersize=5)
        axes.set_yticks(range(len(shown)), [bar.name for bar in shown])
        axes.set_xlim(-0.03, 1.03)
        axes.grid(axis="y", visible=False)
        axes.set_xlabel("share or mean")
    return Plot(
        figure,
        "Grey: where the number should lie. Dot and line: the number and its 90 % interval, orange where it misses.",
    )


def rates_figure(tables: Sequence[tuple[str, dict[str, Rate]]]) -> Figure:
    """Plot of the shares of right verdicts with 90 % intervals, one panel a table."""
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
    """Plot of the share of true names over their probability, by bin; area by the number of names."""
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
    """Plot of the claimed closed share over the true one; filled if the truth was named."""
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


def write_report(score: Score, folder: Path) -> Path:
    """Write `report.html` into the folder of the check."""
    return blind_report(score).save(folder / "report.html")


def blind_report(score: Score) -> Report:
    """Report of bars, the competition's metrics, misses, confusion, sizes, motions, calibration."""
    counts = {state: sum(bar.state == state for bar in score.bars) for state in ("met", "missed", "not measured")}
    pieces: list[Piece] = [
        Paragraph(
            "A diagnosis gets the logs of a simulated device and a simulator that was identified before the device "
            "changed. It has to name what changed, or to say that nothing did, or that it cannot tell. Here its "
            f"answers are set beside the truth, which it never saw. Of {len(score.bars)} requirements "
            f"{', '.join(f'{count} are {state}' for state, count in counts.items())}; "
            f"{len(score.misses())} of {len(score.cases)} verdicts are wrong."
        ),
        Heading("Requirements"),
        Paragraph(
            "Names are asked for at gaps of three floors or more on motions that can tell the effects apart. The floor "
            "is noise and model-form error together; the gap is what a refit of the simulator leaves of the effect. "
            "False alarms, calibration, aliasing and orders are over all cases of their suites. The "
            "interval says what the number could be on other cases: Wilson's for a share, else by resampling the cases."
        ),
        Table(BAR_COLUMNS, [bar_row(bar) for bar in score.bars]),
        bars_plot(score),
        *_missed(score),
        Heading("Beside the DX 2025 competition"),
        Table(
            BAR_COLUMNS,
            [bar_row(bar) for bar in score.metrics],
            "Goal: what the winner reached on an engine. Detection: a structural gap is claimed, named or not.",
        ),
        *_misses(score),
        *_confusion(score),
        *_rates(score),
        *_shares(score),
    ]
    return Report("Blind check of the diagnosis", tuple(pieces), f"{len(score.cases)} cases")


def bar_row(bar: Bar) -> tuple[str, str, str, str, int, str]:
    """Table row of one bar."""
    number = f"{bar.value:.3f}" if math.isfinite(bar.value) else "-"
    interval = f"{bar.ci90[0]:.2f} to {bar.ci90[1]:.2f}" if bar.ci90 and bar.cases else "-"
    return bar.name, number, interval, bar.goal, bar.cases, bar.state


def _confusion(score: Score) -> Iterator[Piece]:
    if not score.confusion.counts.size:
        return
    yield Heading("Confusion matrix")
    yield Plot(
        confusion_figure(score.confusion),
        f"{int(score.confusion.counts.sum())} cases, all but the aliased. "
        "Truth: the largest cause; answer: the first name or the verdict. Shade: "
        "share of the row. Framed: pairs that some motions cannot tell apart.",
    )


def _rates(score: Score) -> Iterator[Piece]:
    yield Heading("Right verdicts by size, effect, motion")
    caption = (
        "Single effects; dot: share, line: 90 % interval, small number: cases. Right on motions that cannot tell the "
        "effect from its twins: leaving it open, or saying that the motions are too little."
    )
    first = [(name, score.groups[name]) for name in ("gap in floors", "recording plan", "separable", "device")]
    second = [(name, score.groups[name]) for name in ("effect", "motion in the plan")]
    for tables in (first, second):
        shown = [(name, rows) for name, rows in tables if rows]
        if shown:
            yield Plot(rates_figure(shown), caption)
    for name in (
        "suite",
        "moved, regrouped or aliased",
        "left out class",
        "baseline",
        "simulator",
        "model error over noise",
    ):
        rows = [(key, f"{r.value:.2f}", r.cases) for key, r in score.groups[name].items()]
        if rows:
            yield Table((name, "right", "cases"), rows)
    if score.beside:
        others = [(name, f"{value:.3f}") for name, value in score.beside.items()]
        yield Table(("answer by", "top-1"), others, "Single effects of all sizes on all motions, strictly.")
    healthy = [(key, f"{r.value:.2f}", r.cases) for key, r in score.groups["nothing wrong, left alone by"].items()]
    if healthy:
        yield Table(("nothing wrong, left alone by", "share", "cases"), healthy, "None, misset, controls and retuned.")


def _shares(score: Score) -> Iterator[Piece]:
    if score.calibration.bins:
        yield Heading("Probabilities")
        error = f"Expected calibration error {score.calibration.error:.3f}; numbers: names in the bin."
        yield Plot(calibration_figure(score.calibration), error)
    points = [
        (true_share(case), case.reading.closed_share, case.right)
        for case in score.cases
        if case.answer.true_closed is not None and case.reading.closed_share is not None and case.reading.claims
    ]
    if points:
        yield Heading("Closed share")
        yield Plot(closed_figure(points), "Filled: the right name; open: a wrong one.")


def _missed(score: Score) -> Iterator[Piece]:
    """Violating cases of each requirement, by name; a met requirement may have some, too."""
    rows = [(bar.name, bar.state, ", ".join(bar.misses)) for bar in score.bars if bar.misses]
    if rows:
        yield Table(("measure", "state", "cases against it"), rows, "What was there and what was said stands below.")


def _misses(score: Score) -> Iterator[Piece]:
    misses = [miss_json(case) for case in score.misses()]
    yield Heading("Wrong verdicts, one by one")
    if not misses:
        yield Paragraph("None.")
        return
    columns = ("case", "suite", "device", "what was there", "verdict", "said", "probability", "what is wrong", "plan")
    rows = [
        (
            miss["case"],
            f"{miss['suite']} ({miss['variant']})" if miss["variant"] else miss["suite"],
            miss["device"],
            "; ".join(miss["effects"]) or "nothing",
            miss["verdict"],
            ", ".join(miss["said"]) or "-",
            f"{miss['probability']:.2f}",
            miss["miss"],
            miss["plan"] if miss["separable"] else f"{miss['plan']}, cannot tell",
        )
        for miss in misses
    ]
    yield Table(columns, rows, f"{len(misses)} of {len(score.cases)} cases; the size of each effect stands beside it.")

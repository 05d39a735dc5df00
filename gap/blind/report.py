"""The page of a blind check's score."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from hystmpc.trials.files import write_atomically
from hystmpc.trials.report import Heading, Paragraph, Piece, Plot, Report, Table

from .bars import Bar, true_share
from .figures import calibration_figure, closed_figure, confusion_figure, rates_figure
from .score import Score, miss_json

BAR_COLUMNS = ("measure", "number", "90 % interval", "goal", "cases", "state")


def write_report(score: Score, folder: Path) -> Path:
    """Write `report.html` into the folder of the check."""
    return write_atomically(folder / "report.html", blind_report(score).html())


def blind_report(score: Score) -> Report:
    """Bars, misses, confusion, sizes, motions, calibration."""
    pieces: list[Piece] = [
        Heading("Bars"),
        Paragraph(
            "At gaps of three floors or more on motions that can tell the effects apart; the floor is noise and "
            "model-form error together, the gap what a refit of the baseline leaves of the effect. False alarms and "
            "calibration are over all cases of their suites."
        ),
        Table(BAR_COLUMNS, [bar_row(bar) for bar in score.bars]),
        Heading("Confusion matrix"),
        Plot(
            confusion_figure(score.confusion),
            f"All {len(score.cases)} cases. Truth: the largest cause; answer: the first name or the verdict. Shade: "
            "share of the row. Framed: pairs that some motions cannot tell apart.",
        ),
        *_rates(score),
        *_shares(score),
        *_misses(score),
    ]
    return Report("Blind check of the diagnosis", tuple(pieces), f"{len(score.cases)} cases")


def bar_row(bar: Bar) -> tuple[str, str, str, str, int, str]:
    """One bar as text."""
    number = f"{bar.value:.3f}" if math.isfinite(bar.value) else "-"
    interval = f"{bar.ci90[0]:.2f} to {bar.ci90[1]:.2f}" if bar.ci90 and bar.cases else "-"
    return bar.name, number, interval, bar.goal, bar.cases, bar.state


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
    for name in ("suite", "left out class", "baseline"):
        rows = [(key, f"{r.value:.2f}", r.cases) for key, r in score.groups[name].items()]
        if rows:
            yield Table((name, "right", "cases"), rows)
    if score.beside:
        others = [(name, f"{value:.3f}") for name, value in score.beside.items()]
        yield Table(("answer by", "top-1"), others, "Single effects of all sizes on all motions, strictly.")
    healthy = [(key, f"{r.value:.2f}", r.cases) for key, r in score.groups["nothing wrong, left alone by"].items()]
    if healthy:
        yield Table(("nothing wrong, left alone by", "share", "cases"), healthy, "None, misset and controls.")


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


def _misses(score: Score) -> Iterator[Piece]:
    misses = [miss_json(case) for case in score.misses()]
    yield Heading("Wrong verdicts, one by one")
    if not misses:
        yield Paragraph("None.")
        return
    columns = ("case", "suite", "truth", "what was there", "verdict", "said", "probability", "plan", "separable")
    rows = [
        (
            miss["case"],
            miss["suite"],
            miss["truth"],
            "; ".join(miss["effects"]) or "nothing",
            miss["verdict"],
            ", ".join(miss["said"]) or "-",
            f"{miss['probability']:.2f}",
            miss["plan"],
            "yes" if miss["separable"] else "no",
        )
        for miss in misses
    ]
    yield Table(columns, rows, f"{len(misses)} of {len(score.cases)} cases; the size of each effect stands beside it.")

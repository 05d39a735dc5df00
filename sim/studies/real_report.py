"""The report of the study on recorded logs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hystmpc.trials.report import (
    ACCENTS,
    COMMAND,
    MEASURED,
    MODEL,
    REFERENCE,
    Heading,
    Paragraph,
    Piece,
    Plot,
    Report,
    new_figure,
)

from .common import jobs_pieces, jobs_table, set_up
from .datasets import LOGS
from .outcome import Outcome
from .real_tables import (
    COUNTS,
    Candidate,
    baseline_of,
    candidates,
    errors_table,
    presets_table,
    signed_rank_table,
    trials_table,
)
from .tables import StudyTable

_DEVICE: Any = {"color": REFERENCE, "linewidth": 2.2, "alpha": 0.5}
_COLOURS = (MODEL, MEASURED, COMMAND, *ACCENTS)
_SHOWN = 2  # of the best models beside the backlash


def real_report(outcome: Outcome) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    pieces = [piece for direction in outcome.settings.directions for piece in _direction(outcome, direction)]
    tables = [piece for piece in pieces if isinstance(piece, StudyTable)]
    shown = [piece.piece if isinstance(piece, StudyTable) else piece for piece in pieces]
    trials = outcome.splits[LOGS]
    page = Report(
        "Study on recorded logs, leave-one-trial-out",
        (*set_up(outcome), *shown, *jobs_pieces(outcome)),
        f"real logs: {', '.join(Path(trial.source).name for trial in trials)}",
    )
    return page, [*tables, jobs_table(outcome)]


def _direction(outcome: Outcome, direction: str) -> Iterator[Piece | StudyTable]:
    units = outcome.splits[LOGS][0].units
    unit = units.angle if direction == "forward" else units.command
    found, broken = candidates(outcome, direction)
    yield Heading(f"{direction.capitalize()} map")
    for candidate in broken:
        yield Paragraph(f"Not compared, some of its fits failed: {candidate.name}.")
    turned = [score.later is not None for c in found for score in c.scores]
    if not all(turned):
        yield Paragraph("Trials whose command never turns are counted whole in either way of counting.")
    if not found:
        return
    for count in COUNTS:
        yield errors_table(found, direction, unit, count)
    presets = presets_table(found, direction, unit)
    if presets is not None:
        yield presets
    yield Plot(examples_figure(outcome, found, unit), "Real: errors over time of the best models and the backlash.")
    for count in COUNTS:
        yield trials_table(found, direction, unit, count)
        tests = signed_rank_table(found, direction, count)
        if tests is not None:
            yield tests


def examples_figure(outcome: Outcome, found: Sequence[Candidate], unit: str) -> Figure:
    """Error over time on every log, of the backlash and the best models; each has not seen the log."""
    base = baseline_of(found)
    ranked = sorted(found, key=lambda c: float(np.mean(c.figures("offset_free_rmse_deg", "later"))))
    best = {c.kind: c for c in reversed(ranked) if base is None or c.kind != base.kind}
    shown = [c for c in ranked if best.get(c.kind) is c][:_SHOWN] + ([base] if base else [])
    trials = outcome.splits[LOGS]
    with new_figure(7.0, 0.6 + 1.3 * len(trials)) as figure:
        rows = figure.subplots(len(trials), 1, sharey=True, squeeze=False)[:, 0]
        for k, (axes, trial) in enumerate(zip(rows, trials, strict=True)):
            for candidate, colour in zip(shown, _COLOURS, strict=False):
                run = outcome.free_run(candidate.results[k].job, trial)
                axes.plot(trial.t, run.theta - run.trial.angle, color=colour, linewidth=0.8, label=candidate.name)
            axes.axhline(0.0, color=REFERENCE, linewidth=0.6)
            axes.set_title(Path(trial.source).name, fontsize=8)
        figure.supylabel(f"error [{unit}]", fontsize=9.0)
        rows[-1].set_xlabel("time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure

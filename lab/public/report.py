"""The page of a public data set: our errors beside the published ones, figure, numbers found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.trials.report import MEASURED, PALETTE, Heading, Piece, Plot, Report, new_figure

from ..page import cell, set_up
from ..tables import NOTHING, Cell, StudyTable
from .catalogue import data_set
from .job import PublicResult, over_record
from .records import Case
from .settings import PublicSettings

_SHOWN, _MOST_PARAMETERS = 400, 12  # samples, numbers


@dataclass(frozen=True, eq=False)
class PublicOutcome:
    """What the study has come to.

    Attributes:
        cases: of the data set.
        results: of all jobs.
        folder, meta: of the run.
    """

    settings: PublicSettings
    cases: Sequence[Case]
    results: Sequence[PublicResult]
    folder: Path
    meta: Mapping[str, Any]

    @property
    def done(self) -> list[PublicResult]:
        """Results of jobs that worked."""
        return [result for result in self.results if result.status == "done"]

    @property
    def failed(self) -> list[PublicResult]:
        """Results that hold an error."""
        return [result for result in self.results if result.status == "failed"]


def errors_table(outcome: PublicOutcome) -> StudyTable:
    """A row for each case, test and kind, and for each published figure; the best of a test first."""
    data = data_set(outcome.settings)
    unit, rows = data.units.angle, list[tuple[str, str, float, list[Cell]]]()
    for r in outcome.done:
        for test, score in r.scores.items():
            figures = [score.rmse, score.spread, 100 * score.rmse / score.span, 100 * score.spread / score.span]
            named: list[Cell] = [r.job.case or NOTHING, test, kind_named(r.job.kind).title, "ours"]
            rows.append((r.job.case, test, score.spread, [*named, *map(cell, figures), round(r.fit_s, 1)]))
    for p in data.published:
        blank = [NOTHING] * 4
        rows.append(("", p.test, p.rmse, [NOTHING, p.test, p.model, "published", p.rmse, *blank]))
    places = {case.name: k for k, case in enumerate(outcome.cases)}
    rows.sort(key=lambda row: (places[row[0]], row[1], row[2]))
    columns = ["case", "test", "model", "from", f"RMSE [{unit}]", f"less its mean [{unit}]"]
    columns += ("RMSE [% of range]", "less its mean [% of range]", "time to fit [s]")
    return StudyTable("errors", columns, [row for *_, row in rows], f"Free runs over the test. {data.note}")


def cases_table(outcome: PublicOutcome) -> StudyTable:
    """What is known of the cases."""
    names = list(dict.fromkeys(name for case in outcome.cases for name in case.facts))
    rows = list[list[Cell]]()
    for case in outcome.cases:
        scored = sum(len(record.trial) - record.first for record in case.tests)
        row: list[Cell] = [case.name or NOTHING, sum(map(len, case.training)), scored]
        rows.append([*row, *(case.facts.get(name, NOTHING) for name in names)])
    return StudyTable(
        "cases", ("case", "samples fitted", "samples scored", *names), rows, "What was fitted and scored."
    )


def parameters_table(outcome: PublicOutcome) -> StudyTable:
    """What a readable model says of the device; of a few numbers only."""
    rows: list[list[Cell]] = [
        [r.job.case or NOTHING, r.job.kind, name, value]
        for r in outcome.done
        if len(r.parameters) <= _MOST_PARAMETERS
        for name, value in r.parameters.items()
    ]
    units = data_set(outcome.settings).units
    caption = f"Identified numbers, units {units.command}, {units.angle} and s."
    return StudyTable("parameters", ("case", "model", "parameter", "value"), rows, caption)


def _against(outcome: PublicOutcome, case: Case, unit: str) -> Figure | None:
    """Measured and predicted at the end of the first test, and what every model leaves, over all samples."""
    done = [r for r in outcome.done if r.job.case == case.name]
    if not done or not case.tests:
        return None
    record = case.tests[0]
    t, measured = record.trial.t[record.first :], record.height * record.trial.angle[record.first :]
    shown = slice(-min(_SHOWN, t.size), None)
    with new_figure(7.0, 4.6) as figure:
        above, below = figure.subplots(2, 1)
        above.plot(t[shown], measured[shown], color=MEASURED, label="measured")
        for k, r in enumerate(done):
            left = record.errors(over_record(r.job, outcome.folder, record))
            colour = PALETTE[1 + k % (len(PALETTE) - 1)]
            above.plot(t[shown], (measured + left)[shown], "--", color=colour, label=kind_named(r.job.kind).title)
            below.plot(t, left, color=colour, linewidth=0.5)
        above.set(xlabel="time [s]", ylabel=f"output [{unit}]")
        below.set(xlabel="time [s]", ylabel=f"predicted - measured [{unit}]")
        figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def public_report(outcome: PublicOutcome) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    data = data_set(outcome.settings)
    errors, cases, parameters = errors_table(outcome), cases_table(outcome), parameters_table(outcome)
    given = [Path(file).name for file in outcome.settings.test]
    facts = {"data set": outcome.settings.dataset, "data": Path(outcome.settings.data).name}
    facts |= {"files of the test": ", ".join(given) or "none given"}
    plots = []
    for case in outcome.cases:
        if (figure := _against(outcome, case, data.units.angle)) is not None:
            first = case.tests[0]
            how = "simulated here" if first.simulated else "recorded"
            plots.append(Plot(figure, f"{case.name} {first.name} ({how}), its end, and what is left over all of it."))
    numbers: tuple[Piece, ...] = (Heading("Numbers found"), parameters.piece) if parameters.rows else ()
    head = set_up(data.about, facts, outcome)
    pieces = (*head, cases.piece, Heading("Errors"), errors.piece, Heading("Predicted and measured"), *plots, *numbers)
    return Report(data.title, pieces, "models identified from public data"), [errors, cases, parameters]

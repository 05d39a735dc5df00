"""The page of a public data set: our errors beside the published ones, figure, numbers found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.trials.report import MEASURED, PALETTE, Heading, Paragraph, Piece, Plot, Report, new_figure

from ..page import cell, set_up
from ..tables import NOTHING, Cell, StudyTable
from .boucwen import PUBLISHED, RATE_HZ, UNITS, ScoredRecord, noise_of_periods, read_record
from .job import PublicResult, over_record, tests_of
from .settings import PublicSettings

_ABOUT = """The Bouc-Wen benchmark: a force in N moves a mass on a spring with a hysteretic force behind it. Its
displacement in m is to be predicted from the force alone. Models are identified from the training record and run
freely over the test, from rest; over one period of a steady state they run three times, and the third counts. RMSE is
over all samples."""
_SIMULATED = """No test record was given: the test is our own simulation of the published system (Runge-Kutta at 15
kHz, no noise), a multisine of another realisation and a sine sweep. The published figures are of the official
multisine test, so the comparison says where we stand and is no official score."""
_GIVEN = "The test records are the files that were given."
_SHOWN_S, _MOST_PARAMETERS = 0.5, 12


@dataclass(frozen=True, eq=False)
class PublicOutcome:
    """What the study has come to.

    Attributes:
        results: of all jobs.
        folder, meta: of the run.
    """

    settings: PublicSettings
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
    """A row for each kind, and for each published figure, which is of the first test record, sorted by it."""
    names = [record.name for record in tests_of(outcome.settings)]
    rows: list[list[Cell]] = []
    for r in outcome.done:
        errors = [cell(r.rmse[name]) for name in names]
        rows.append([kind_named(r.job.kind).title, "ours", *errors, round(r.fit_s, 1)])
    blank = [NOTHING] * (len(names) - 1)
    rows += [[name, "published", rmse, *blank, NOTHING] for name, rmse in PUBLISHED]
    rows.sort(key=lambda row: row[2] if isinstance(row[2], float) else math.inf)
    columns = ("model", "from", *(f"{name} [{UNITS.angle}]" for name in names), "time to fit [s]")
    test = "given" if outcome.settings.test else "SIMULATED here; published figures are of the official multisine"
    return StudyTable("errors", columns, rows, f"RMSE of free runs over the test, {test}.")


def parameters_table(outcome: PublicOutcome) -> StudyTable:
    """What a readable model says of the device; of a few numbers only."""
    rows: list[list[Cell]] = [
        [name, value]
        for r in outcome.done
        if len(r.parameters) <= _MOST_PARAMETERS
        for name, value in r.parameters.items()
    ]
    return StudyTable("parameters", ("parameter", "value"), rows, "Identified numbers, units N, m and s.")


def _against(outcome: PublicOutcome, record: ScoredRecord) -> Figure:
    """Measured and predicted over the last half second, and what every model leaves, over all samples."""
    runs = {r.job.kind: over_record(r.job, outcome.folder, record) for r in outcome.done}
    shown = slice(-min(round(_SHOWN_S * RATE_HZ), len(record.trial)), None)
    t, measured = record.trial.t, record.trial.angle
    with new_figure(7.0, 4.6) as figure:
        above, below = figure.subplots(2, 1)
        above.plot(t[shown], 1e3 * measured[shown], color=MEASURED, label="measured")
        for k, (kind, run) in enumerate(runs.items()):
            colour = PALETTE[1 + k % (len(PALETTE) - 1)]
            above.plot(t[shown], 1e3 * run[shown], "--", color=colour, label=kind_named(kind).title)
            below.plot(t, 1e6 * (run - measured), color=colour, linewidth=0.5)
        above.set(xlabel="time [s]", ylabel="displacement [mm]")
        below.set(xlabel="time [s]", ylabel="predicted - measured [um]")
        figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def public_report(outcome: PublicOutcome) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    settings, records = outcome.settings, tests_of(outcome.settings)
    errors, parameters = errors_table(outcome), parameters_table(outcome)
    training = read_record(settings.data)
    noise = noise_of_periods(training)
    facts = {
        "data set": settings.dataset,
        "training record": f"{Path(settings.data).name}: {len(training)} samples at {RATE_HZ:g} Hz",
        "noise in it": f"{noise:.3g} m, from what differs between its periods" if np.isfinite(noise) else "unknown",
        "test": ", ".join(f"{r.name}, {len(r.trial)} samples" for r in records),
    }
    caption = f"{'Simulated' if records[0].simulated else 'Given'}: {records[0].name}, its end, and what is left."
    numbers: tuple[Piece, ...] = (Heading("Numbers found"), parameters.piece) if parameters.rows else ()
    page = Report(
        "A public benchmark: Bouc-Wen",
        (
            *set_up(_ABOUT, facts, outcome),
            Paragraph(_GIVEN if settings.test else _SIMULATED),
            Heading("Errors"),
            errors.piece,
            *([Plot(_against(outcome, records[0]), caption)] if outcome.done else []),
            *numbers,
        ),
        "models identified from the training record of a public benchmark, beside what others print",
    )
    return page, [errors, parameters]

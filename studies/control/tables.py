"""Tables of the benchmark: bars, a row for each controller, a row for each run, gains and jobs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from ..tables import NOTHING, Cell, StudyTable
from .bars import BARS, Verdict
from .motions import SCANS_HZ
from .outcome import ControlOutcome
from .result import ControlResult

_RUN_COLUMNS = (
    "RMSE [deg]",
    "max [deg]",
    "hold error [deg]",
    "hold range [half-widths]",
    "before the next move shows",
    "holds cycling",
    "travel [mm]",
    "beyond limits",
    "ladder",
    "late steps (not judged)",
    "over oracle",
    "over best of PID, inverse, both",
)
_FIGURES = (
    "rmse_deg",
    "max_deg",
    "hold_error_deg",
    "hold_range",
    "rest_range",
    "cycling_holds",
    "travel",
    "violations",
    "fallbacks",
    "late_share",
)


def bars_table(verdicts: Sequence[Verdict]) -> StudyTable:
    """Each bar over everything that it is about: how many controllers on how many plants meet it."""
    rows: list[list[Cell]] = []
    for bar in BARS:
        about = [verdict for verdict in verdicts if verdict.bar == bar.name]
        if not about:
            rows.append([bar.name, bar.limit, 0, 0, NOTHING, NOTHING, "not judged: nothing was run that it is about"])
            continue
        met = sum(verdict.met for verdict in about)
        worst = max(about, key=lambda verdict: verdict.worst)
        where = f"{worst.controller} on {worst.plant} at {worst.rate_hz:g} Hz, {worst.motion}"
        rows.append([bar.name, bar.limit, met, len(about), worst.worst, where, _word(met == len(about))])
    columns = ("bar", "at most", "loops that meet it", "loops judged", "worst", "where", "verdict")
    caption = "Simulated: the bars; a loop is a controller on a plant at a rate, and meets a bar on all its motions."
    return StudyTable("bars", columns, rows, caption)


def verdicts_table(verdicts: Sequence[Verdict], met: bool | None = None) -> StudyTable:
    """Every bar on every loop, or only those met or missed."""
    rows: list[list[Cell]] = [
        [v.bar, v.limit, v.plant, v.rate_hz, v.controller, f"{v.within} of {v.judged}", v.worst, v.motion, _word(v.met)]
        for v in verdicts
        if met is None or v.met == met
    ]
    columns = ("bar", "at most", "plant", "rate [Hz]", "controller", "motions within", "worst", "motion", "verdict")
    name = "verdicts" if met is None else "verdicts_met" if met else "verdicts_missed"
    return StudyTable(name, columns, rows, "Simulated: every bar on every loop that it is about.")


def loop_table(outcome: ControlOutcome, plant: str, rate_hz: float) -> StudyTable:
    """One plant at one rate, a row for each controller: means over its motions, greatest where it says so."""
    rows: list[list[Cell]] = []
    for controller in outcome.settings.controllers:
        runs = [run for run in outcome.runs if _is(run, plant, rate_hz, controller)]
        if not runs:
            continue
        scans = [run for run in runs if run.job.motion in SCANS_HZ]
        others = [run for run in runs if run.job.motion not in SCANS_HZ]
        over = [_mean(map(ratio, runs)) for ratio in (outcome.over_oracle, outcome.over_baseline)]
        rows.append(
            [
                controller,
                _mean(run.figures["rmse_deg"] for run in others),
                _mean(run.figures["rmse_deg"] for run in scans),
                _worst(run.figures["max_deg"] for run in runs),
                _mean(run.figures["hold_error_deg"] for run in runs),
                _worst(run.figures["hold_range"] for run in runs),
                _worst(run.figures["rest_range"] for run in runs),
                _mean(run.figures["cycling_holds"] for run in runs),
                _mean(run.figures["travel"] for run in runs),
                int(sum(run.figures["violations"] for run in runs)),
                int(sum(run.figures["fallbacks"] for run in runs)),
                *over,
            ]
        )
    columns = ("controller", "RMSE point to point [deg]", "RMSE scans [deg]", *_RUN_COLUMNS[1:9], *_RUN_COLUMNS[10:])
    caption = f"Simulated: {plant} at {rate_hz:g} Hz, means over motions; max and hold ranges are the greatest."
    return StudyTable(f"{plant}_{rate_hz:g}hz", columns, rows, caption)


def runs_table(outcome: ControlOutcome) -> StudyTable:
    """Every run; CSV only."""
    rows: list[list[Cell]] = [
        [
            *(run.job.plant, run.job.rate_hz, run.job.subject, run.job.motion),
            *(_cell(run.figures[name]) for name in _FIGURES),
            _cell(outcome.over_oracle(run)),
            _cell(outcome.over_baseline(run)),
            "; ".join(f"{source} {count}" for source, count in run.ladder.items()),
        ]
        for run in outcome.runs
    ]
    columns = ("plant", "rate [Hz]", "controller", "motion", *_RUN_COLUMNS, "samples by source")
    return StudyTable("runs", columns, rows, "", shown=False)


def preparation_table(outcome: ControlOutcome) -> StudyTable:
    """Models and gains: how each was found."""
    rows: list[list[Cell]] = [
        [
            r.job.stage,
            r.job.plant,
            _cell(r.job.rate_hz or math.nan),
            r.job.subject,
            round(r.seconds, 1),
            r.status,
            r.message,
        ]
        for r in outcome.results
        if r.job.stage != "run"
    ]
    columns = ("stage", "plant", "rate [Hz]", "what", "time [s]", "status", "how")
    return StudyTable("preparation", columns, rows, "Models, identified on the nominal plant, and gains of the PIDs.")


def _is(run: ControlResult, plant: str, rate_hz: float, controller: str) -> bool:
    return (run.job.plant, run.job.rate_hz, run.job.subject) == (plant, rate_hz, controller)


def _word(met: bool) -> str:
    return "met" if met else "MISSED"


def _mean(values: Iterable[float]) -> Cell:
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else NOTHING


def _worst(values: Iterable[float]) -> Cell:
    return max((value for value in values if not math.isnan(value)), default=NOTHING)


def _cell(value: float) -> Cell:
    return NOTHING if math.isnan(value) else value

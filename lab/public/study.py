"""Study `public`: every kind of model on every case of a public data set, and its page."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.evaluate import free_run
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.simulator import ChainModel, load_simulator, save_simulator
from hystmpc.trials.report import MEASURED, PALETTE, Heading, Piece, Plot, Report, new_figure
from hystmpc.trials.types import Vec

from ..page import NOTHING, Cell, StudyTable, cell, set_up
from ..study import Outcome, Study
from .boucwen import BoucWenData
from .logs import RigData, SealData
from .records import Case, PublicData, PublicJob, PublicResult, PublicSettings, Score, ScoredRecord


def data_set(settings: PublicSettings) -> PublicData:
    """Data set of these settings."""
    known: dict[str, type[PublicData]] = {"boucwen": BoucWenData, "seals": SealData, "rig": RigData}
    return known[settings.dataset]()


_LAPS = 3  # passes over a period: the first two end the transient


def run_kind(job: PublicJob, settings: PublicSettings, folder: Path) -> dict[str, Any]:
    """Execute a job, write its model; return message, time, parameters and scores, see `PublicResult`."""
    kind = kind_named(job.kind)
    case = next(case for case in data_set(settings).cases(settings) if case.name == job.case)
    request = FitRequest(kind.usual_training(False), settings.seed, settings.steps(job.kind))
    start = time.perf_counter()
    identified = kind.fit(case.training, request)
    seconds = time.perf_counter() - start
    (folder / "models").mkdir(exist_ok=True)
    export_onnx(identified.bundle, _file(job, folder, "onnx"))
    parameters: dict[str, float] = {}
    if identified.simulator is not None:
        save_simulator(identified.simulator, _file(job, folder, "yaml"))
        chain = identified.simulator.chain
        parameters = dict(zip(chain.labels, chain.values.tolist(), strict=True))
    scores = {}
    for record in case.tests:
        left = record.errors(over_record(job, folder, record))
        scores[record.name] = Score(float(np.sqrt(np.mean(left**2))), float(np.std(left)), record.span)
    return {"message": identified.report, "fit_s": seconds, "parameters": parameters, "scores": scores}


def over_record(job: PublicJob, folder: Path, record: ScoredRecord) -> Vec:
    """Free run (T,) of the model in the folder over a test record; of a periodic one the steady state."""
    commands, readable = record.trial.command, _file(job, folder, "yaml")
    laps = np.tile(commands, _LAPS if record.periodic else 1)
    if readable.exists():
        run = ChainModel(load_simulator(readable)).run(laps, record.start)
    else:
        run = free_run(load_onnx(_file(job, folder, "onnx")), laps, record.start)
    return run[-commands.size :]


def _file(job: PublicJob, folder: Path, suffix: str) -> Path:
    return folder / "models" / f"{job.key}.{suffix}"


PublicOutcome = Outcome[PublicSettings, PublicResult]
"""With the cases of the data set as what was drawn."""
_SHOWN, _MOST_PARAMETERS = 400, 12  # samples, numbers


def errors_table(outcome: PublicOutcome) -> StudyTable:
    """Table of errors: a row for each case, test and kind, and for each published figure; best first."""
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
    places = {case.name: k for k, case in enumerate(outcome.drawn)}
    rows.sort(key=lambda row: (places[row[0]], row[1], row[2]))
    columns = ["case", "test", "model", "from", f"RMSE [{unit}]", f"less its mean [{unit}]"]
    columns += ("RMSE [% of range]", "less its mean [% of range]", "time to fit [s]")
    return StudyTable("errors", columns, [row for *_, row in rows], f"Free runs over the test. {data.note}")


def cases_table(outcome: PublicOutcome) -> StudyTable:
    """Table of known facts of the cases."""
    names = list(dict.fromkeys(name for case in outcome.drawn for name in case.facts))
    rows = list[list[Cell]]()
    for case in outcome.drawn:
        scored = sum(len(record.trial) - record.first for record in case.tests)
        row: list[Cell] = [case.name or NOTHING, sum(map(len, case.training)), scored]
        rows.append([*row, *(case.facts.get(name, NOTHING) for name in names)])
    return StudyTable(
        "cases", ("case", "samples fitted", "samples scored", *names), rows, "What was fitted and scored."
    )


def parameters_table(outcome: PublicOutcome) -> StudyTable:
    """Table of the parameters of readable models with few numbers."""
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
    """Plots of measured and predicted signal at the end of the first test, and of every model's error."""
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
    """Page of the study, and all tables that are written as CSV."""
    data = data_set(outcome.settings)
    errors, cases, parameters = errors_table(outcome), cases_table(outcome), parameters_table(outcome)
    given = [Path(file).name for file in outcome.settings.test]
    facts = {"data set": outcome.settings.dataset, "data": Path(outcome.settings.data).name}
    facts |= {"files of the test": ", ".join(given) or "none given"}
    plots = []
    for case in outcome.drawn:
        if (figure := _against(outcome, case, data.units.angle)) is not None:
            first = case.tests[0]
            how = "simulated here" if first.simulated else "recorded"
            plots.append(Plot(figure, f"{case.name} {first.name} ({how}), its end, and what is left over all of it."))
    numbers: tuple[Piece, ...] = (Heading("Numbers found"), parameters.piece) if parameters.rows else ()
    head = set_up(data.about, facts, outcome)
    pieces = (*head, cases.piece, Heading("Errors"), errors.piece, Heading("Predicted and measured"), *plots, *numbers)
    return Report(data.title, pieces, "models identified from public data"), [errors, cases, parameters]


# Processor seconds of a fit on one core of a two-core x86-64 machine, from runs of the study itself.
_FIT_S = {"oscillator": 15.0, "state_network": 200.0, "auto": 20.0, "maxwell_slip_rate": 15.0}
_OTHER_S, _QUICK_S = 10.0, 30.0


def _cases(settings: PublicSettings) -> Sequence[Case]:
    return data_set(settings).cases(settings)


def _jobs(settings: PublicSettings, cases: Sequence[Case]) -> tuple[PublicJob, ...]:
    return tuple(PublicJob(case.name, kind) for case in cases for kind in dict.fromkeys(settings.kinds))


def _inputs(job: PublicJob, settings: PublicSettings, folder: Path) -> dict[str, Any]:
    del folder
    files = [hashlib.sha256(path.read_bytes()).hexdigest() for path in data_set(settings).files(settings)]
    return settings.model_dump(mode="json") | {"kinds": job.kind, "data": job.case, "test": files}


def _costs(jobs: Sequence[PublicJob], settings: PublicSettings) -> Mapping[str, float]:
    return {job.key: _QUICK_S if settings.quick else _FIT_S.get(job.kind, _OTHER_S) for job in jobs}


STUDY = Study(
    name="public",
    form="hystmpc-public-job/2",
    settings=PublicSettings.of,
    result=PublicResult,
    draw=_cases,
    jobs=_jobs,
    run=run_kind,
    inputs=_inputs,
    costs=_costs,
    page=public_report,
    summary=errors_table,
    digits=3,
)

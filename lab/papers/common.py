"""Report parts of every study: set-up, failures, time of each job."""

from __future__ import annotations

from collections.abc import Iterator

from hystmpc.trials.report import Heading, Piece

from ..study import NOTHING, Cell, StudyTable, set_up
from .printed import MARKS
from .result import PaperOutcome, title_of
from .settings import PaperSettings

SOURCES = {
    "s1": "simulated: the pressure-driven catheter of S1 as this package simulates it (hystmpc.sim.devices)",
    "s2": "simulated: the tendon catheter of S2 as this package simulates it (hystmpc.sim.devices)",
    "real": "real: recorded logs",
}


def label(study: str) -> str:
    """`simulated` or `real`: stands at every table and figure."""
    return SOURCES[study].partition(":")[0]


def paper_set_up(outcome: PaperOutcome) -> Iterator[Piece]:
    """Set-up of the study: settings, kinds left out, failed jobs."""
    settings = outcome.settings
    facts = {
        "trials": SOURCES[settings.study],
        "kinds of model": ", ".join(settings.kinds),
        "not in the catalogue, left out": ", ".join(settings.left_out) or "none",
        "presets": ", ".join(outcome.presets),
        "directions": ", ".join(settings.directions),
        "stages": ", ".join(settings.stages),
        "training": training_note(settings),
        "seed": settings.seed,
    }
    marks = f"Marks of the paper's numbers and signs: {MARKS}. All others are ours, {label(settings.study)}."
    return set_up("", facts, outcome, "" if settings.study == "real" else marks)


def training_note(settings: PaperSettings) -> str:
    """Share of the papers' training that was done, in words."""
    if settings.quick:
        return (
            "QUICK: a hundredth of the training on a few shortened trials. The numbers below show that everything "
            "runs, and say nothing about the models."
        )
    if settings.epochs_scale == 1.0:
        return "networks with the preset 'paper' are trained for all of the paper's epochs"
    return (
        f"networks with the preset 'paper' are trained for {settings.epochs_scale:g} of the paper's epochs "
        "(--epochs-scale), which favours models that need little training"
    )


def jobs_table(outcome: PaperOutcome) -> StudyTable:
    """A row for every job, failed ones included."""
    rows: list[list[Cell]] = []
    for result in outcome.results:
        job = result.job
        what: list[Cell] = [job.stage, title_of(job.kind), job.preset, job.direction, job.train]
        beta: Cell = NOTHING if job.constancy is None else job.constancy
        steps: Cell = "preset's" if job.steps is None else job.steps
        rows.append([*what, beta, steps, result.samples, round(result.seconds, 1), result.status, result.message])
    columns = ("stage", "model", "preset", "direction", "trained on", "beta", "steps", "samples", "time [s]")
    caption = f"Every job ({label(outcome.settings.study)}); time is wall time on one thread."
    return StudyTable("jobs", (*columns, "status", "fit or error"), rows, caption)


def jobs_pieces(outcome: PaperOutcome) -> Iterator[Piece]:
    """Heading and table of the jobs."""
    yield Heading("Jobs")
    yield jobs_table(outcome).piece

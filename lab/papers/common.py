"""Report parts of every study: set-up, failures, time of each job."""

from __future__ import annotations

from collections.abc import Iterator

from hystmpc.trials.report import Heading, KeyValues, Paragraph, Piece

from ..tables import NOTHING, Cell, StudyTable
from .printed import MARKS
from .result import StudyOutcome, title_of
from .settings import StudySettings

SOURCES = {
    "s1": "simulated: the pressure-driven catheter of S1 as this package simulates it (hystmpc.sim.devices)",
    "s2": "simulated: the tendon catheter of S2 as this package simulates it (hystmpc.sim.devices)",
    "real": "real: recorded logs",
}


def label(study: str) -> str:
    """`simulated` or `real`: stands at every table and figure."""
    return SOURCES[study].partition(":")[0]


def set_up(outcome: StudyOutcome) -> Iterator[Piece]:
    """Set-up of the study: settings, kinds left out, failed jobs."""
    settings = outcome.settings
    yield Heading("Set-up")
    yield KeyValues(
        {
            "trials": SOURCES[settings.study],
            "kinds of model": ", ".join(settings.kinds),
            "not in the catalogue, left out": ", ".join(settings.left_out) or "none",
            "presets": ", ".join(outcome.presets),
            "directions": ", ".join(settings.directions),
            "stages": ", ".join(settings.stages),
            "training": training_note(settings),
            "seed": settings.seed,
            "jobs": f"{len(outcome.done)} done, {len(outcome.failed)} failed",
            "processor time of all jobs": f"{sum(r.seconds for r in outcome.results) / 60:.1f} min",
            "hystmpc": outcome.meta.get("versions", {}).get("hystmpc"),
            "started": outcome.meta.get("start"),
        }
    )
    if settings.study != "real":
        yield Paragraph(
            f"Marks of the paper's numbers and signs: {MARKS}. All others are ours, {label(settings.study)}."
        )
    for result in outcome.failed:
        yield Paragraph(f"FAILED: {result.job.key}: {result.message}")


def training_note(settings: StudySettings) -> str:
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


def jobs_table(outcome: StudyOutcome) -> StudyTable:
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


def jobs_pieces(outcome: StudyOutcome) -> Iterator[Piece]:
    """Heading and table of the jobs."""
    yield Heading("Jobs")
    yield jobs_table(outcome).piece

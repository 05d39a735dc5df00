"""A study of next to nothing: numbers drawn from a seed are halved one by one, then summed.

Worker processes import it by the name `sums_study`, which no test module has for them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from hystmpc.trials.errors import FitError
from hystmpc.trials.report import Heading, Report
from hystmpc_lab.page import StudyTable, figures_table, set_up
from hystmpc_lab.study import Figure, Outcome, Result, Study, StudySettings


class SumSettings(StudySettings):
    """Numbers drawn from a seed, halved one by one, then summed."""

    QUICK = {"count": 2}  # noqa: RUF012 - as in every study
    study: Literal["sums"] = "sums"
    count: Annotated[int, Field(ge=1)] = 3
    broken: int = -1


@dataclass(frozen=True)
class SumJob:
    stage: str
    number: int

    @property
    def key(self) -> str:
        return f"{self.stage}-{self.number}"


@dataclass(frozen=True)
class SumResult(Result):
    job: SumJob
    drawn: int = 0
    figures: Mapping[str, Figure] = field(default_factory=dict)


def numbers(settings: SumSettings) -> list[int]:
    return [10 * settings.seed + k for k in range(settings.count)]


def sum_jobs(settings: SumSettings, drawn: Sequence[int]) -> list[SumJob]:
    return [*(SumJob("half", k) for k in range(len(drawn))), SumJob("sum", 0)]


def run_job(job: SumJob, settings: SumSettings, folder: Path) -> dict[str, Any]:
    if job.stage == "sum":
        total = sum(float(file.read_text()) for file in sorted(folder.glob("*.txt")))
        return {"message": "summed", "figures": {"total": total, "missing": math.nan}}
    if job.number == settings.broken:
        raise FitError("cannot be halved")
    (folder / f"{job.number}.txt").write_text(str(0.5 * numbers(settings)[job.number]))
    return {"figures": {"half": 0.5 * numbers(settings)[job.number]}}


def inputs(job: SumJob, settings: SumSettings, folder: Path) -> dict[str, Any]:
    if job.stage == "sum":
        return {"files": [file.read_text() for file in sorted(folder.glob("*.txt"))]}
    return {"number": numbers(settings)[job.number]}


def facts(job: SumJob, settings: SumSettings) -> dict[str, Any]:
    return {"drawn": numbers(settings)[job.number]}


def costs(jobs: Sequence[SumJob], settings: SumSettings) -> dict[str, float]:
    return {job.key: 60.0 for job in jobs}


def page(outcome: Outcome[SumSettings, SumResult]) -> tuple[Report, list[StudyTable]]:
    table = figures_table({r.job.key: r.figures for r in outcome.results})
    pieces = (*set_up("Numbers are halved.", {"count": outcome.settings.count}, outcome), Heading("Sums"), table.piece)
    return Report("Sums", pieces, "simulated"), [table]


def data(outcome: Outcome[SumSettings, SumResult]) -> dict[str, Any]:
    return {"drawn": outcome.drawn}


STUDY = Study(
    name="sums",
    form="hystmpc-sums-job/1",
    settings=SumSettings.of,
    result=SumResult,
    draw=numbers,
    jobs=sum_jobs,
    run=run_job,
    inputs=inputs,
    costs=costs,
    facts=facts,
    page=page,
    data=data,
    stages=("half", "sum"),
)

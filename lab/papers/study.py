"""Studies `s1`, `s2` and `real`: kinds of model trained and tested as in the papers, or on recorded logs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hystmpc.trials.report import Report

from ..page import StudyTable
from ..study import Study
from .job import JobResult, PaperOutcome, Splits, TrainingTask, estimated_seconds, run_task, study_splits
from .real import real_report, real_tasks
from .s1 import s1_report, s1_tasks
from .s2_report import s2_report
from .s2_tables import s2_tasks
from .settings import PaperSettings

PaperStudy = Study[PaperSettings, TrainingTask, JobResult]


def _inputs(task: TrainingTask, settings: PaperSettings, folder: Path) -> list[Any]:
    del settings, folder
    return task.inputs


def _facts(task: TrainingTask, settings: PaperSettings) -> dict[str, Any]:
    del settings
    return {"job": task.job, "samples": task.samples}


def _study(
    name: str,
    tasks: Callable[[PaperSettings, Splits], Sequence[TrainingTask]],
    page: Callable[[PaperOutcome], tuple[Report, list[StudyTable]]],
) -> PaperStudy:
    return Study(
        name=name,
        form="hystmpc-study-job/1",
        settings=partial(PaperSettings.for_study, name),
        result=JobResult,
        draw=study_splits,
        jobs=tasks,
        run=run_task,
        inputs=_inputs,
        costs=estimated_seconds,
        facts=_facts,
        page=page,
        outcome=PaperOutcome,
        encode=asdict,
    )


STUDIES: Mapping[str, PaperStudy] = MappingProxyType(
    {
        "s1": _study("s1", s1_tasks, s1_report),
        "s2": _study("s2", s2_tasks, s2_report),
        "real": _study("real", real_tasks, real_report),
    }
)

"""The study `public`: every kind of model on every case of a public data set."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..study import Study
from .catalogue import data_set
from .job import run_kind
from .records import Case
from .report import errors_table, public_report
from .settings import PublicJob, PublicResult, PublicSettings

# Processor seconds of a fit on one core of a two-core x86-64 machine, from runs of the study itself.
_FIT_S = {"oscillator": 15.0, "state_network": 200.0, "auto": 20.0, "maxwell_slip_rate": 15.0}
_OTHER_S, _QUICK_S = 10.0, 30.0


def _cases(settings: PublicSettings) -> Sequence[Case]:
    return data_set(settings).cases(settings)


def _jobs(settings: PublicSettings, cases: Sequence[Case]) -> tuple[PublicJob, ...]:
    """A job for each case and kind."""
    return tuple(PublicJob(case.name, kind) for case in cases for kind in dict.fromkeys(settings.kinds))


def _inputs(job: PublicJob, settings: PublicSettings, folder: Path) -> dict[str, Any]:
    """The settings and the files."""
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

"""The whole study: a job for each device, bars, report; in a run folder that the same command goes on from."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from hystmpc.sim.jobs.runner import attempt
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Progress

from ..ready import ReadyStudy, ready_study
from .bars import IdentifyOutcome, bars
from .job import IdentifyJob, IdentifyResult, as_result, fingerprint, identify_jobs, plain, result_files, study_device
from .report import identify_report
from .settings import IdentifySettings

# Processor seconds of a device on one core of a two-core x86-64 machine, from runs of the study itself.
_DEVICE_S = {25.0: 30.0, 50.0: 45.0, 250.0: 140.0}
_ROD = 3.0
_QUICK_S = 5.0


def prepare_identify(
    settings: IdentifySettings, out: Path | str
) -> ReadyStudy[IdentifySettings, IdentifyJob, IdentifyResult]:
    """Draw the devices and open the folder; see `ready_study`."""
    return ready_study(
        settings,
        settings.study,
        identify_jobs(settings),
        out,
        result_files,
        lambda job, folder: fingerprint(job, settings),
        lambda jobs: {job.key: _cost_s(job, settings) for job in jobs},
    )


def run_identify(
    study: ReadyStudy[IdentifySettings, IdentifyJob, IdentifyResult], workers: int = 1, progress: Progress | None = None
) -> IdentifyOutcome:
    """Do the open jobs and write report, tables and results; see `ReadyStudy.complete` for arguments and errors."""
    folder = study.folder.path
    do = partial(do_job, settings=study.settings, folder=folder)
    results = study.complete([study.jobs], do, workers, progress)
    outcome = IdentifyOutcome(study.settings, results, folder, study.folder.meta)
    page, tables = identify_report(outcome)
    for table in tables:
        table.save(folder)
    judged = [
        asdict(bar) | {"state": bar.state, "value": bar.value if bar.value < 1e300 else None} for bar in bars(outcome)
    ]
    data = {"bars": judged, "devices": [plain(result) for result in results]}
    write_atomically(folder / "tables" / "identify.json", json.dumps(data, indent=1) + "\n")
    study.folder.write_report(page.html())
    return outcome


def do_job(job: IdentifyJob, settings: IdentifySettings, folder: Path) -> IdentifyResult:
    """Do one job and write its result; an error is a result too.

    Raises:
        KeyboardInterrupt: if the user ended it; nothing is written then.
    """
    made = attempt(lambda: study_device(job, settings, folder))
    result = replace(as_result(job, settings), message=made.error, seconds=made.seconds)
    if made.value is not None:
        message, found, figures = made.value
        result = replace(result, status="done", message=message, found=found, figures=figures)
    result_files(folder).save(result)
    return result


def _cost_s(job: IdentifyJob, settings: IdentifySettings) -> float:
    if settings.quick:
        return _QUICK_S
    rate = float(job.key.rsplit("-", 1)[1].removesuffix("hz"))
    return _DEVICE_S[rate] * (_ROD if "-rod-" in job.key else 1.0)

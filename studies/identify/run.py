"""The whole study: a job for each device, bars, report; in a run folder that the same command goes on from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from hystmpc.sim.jobs.runner import attempt, backend_for, resumed_folder, wall_minutes
from hystmpc.trials.files import write_atomically
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import Progress

from ..tables import other_study
from .bars import IdentifyOutcome, bars
from .job import IdentifyJob, IdentifyResult, as_result, fingerprint, identify_jobs, plain, result_files, study_device
from .report import identify_report
from .settings import IdentifySettings

# Processor seconds of a device on one core of a two-core x86-64 machine, from runs of the study itself.
_DEVICE_S = {25.0: 30.0, 50.0: 45.0, 250.0: 120.0}
_ROD = 1.5
_QUICK_S = 5.0


@dataclass(frozen=True, eq=False)
class IdentifyStudy:
    """The study made ready: its folder is there, nothing has run yet."""

    settings: IdentifySettings
    jobs: tuple[IdentifyJob, ...]
    folder: RunFolder
    costs: Mapping[str, float]
    open: frozenset[str]

    def minutes(self, workers: int) -> int:
        """Estimated wall time of the jobs that are not done yet [min]."""
        return wall_minutes({key: self.costs[key] for key in self.open}, workers)


def prepare_identify(settings: IdentifySettings, out: Path | str) -> IdentifyStudy:
    """Draw the devices and open the folder.

    Args:
        out: a new or empty folder, or one in which the study was begun; its finished jobs are kept.

    Raises:
        ConfigError: if the folder holds something else.
        LogError: if a result is damaged.
    """
    jobs = identify_jobs(settings)
    refusal = partial(other_study, settings.study)
    folder = resumed_folder(Path(out), settings.model_dump(mode="json"), settings.seed, refusal)
    done = result_files(folder.path).kept(jobs, partial(fingerprint, settings=settings))
    costs = {job.key: _expected_s(job, settings) for job in jobs}
    return IdentifyStudy(settings, jobs, folder, costs, frozenset(job.key for job in jobs if job.key not in done))


def run_identify(study: IdentifyStudy, workers: int = 1, progress: Progress | None = None) -> IdentifyOutcome:
    """Do the open jobs and write report, tables and results.

    Args:
        study: made by `prepare_identify`.
        workers: processes, each on one thread; with 1 the jobs run in this process.
        progress: see `ResultFiles.complete`.

    Raises:
        ConfigError: if worker processes died again and again.
        LogError: if a result's file is damaged.
        KeyboardInterrupt: if the user ended it; finished jobs are kept, the report is not written.
    """
    folder = study.folder.path
    results = result_files(folder).complete(
        [study.jobs],
        partial(do_job, settings=study.settings, folder=folder),
        partial(fingerprint, settings=study.settings),
        backend_for(workers, where=str(folder)),
        study.costs,
        progress,
    )
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


def _expected_s(job: IdentifyJob, settings: IdentifySettings) -> float:
    if settings.quick:
        return _QUICK_S
    rate = float(job.key.rsplit("-", 1)[1].removesuffix("hz"))
    return _DEVICE_S[rate] * (_ROD if "-rod-" in job.key else 1.0)

"""The whole benchmark: jobs, bars, report; in a run folder that it goes on from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from hystmpc.trials.files import write_atomically
from hystmpc.trials.run_folder import RunFolder

from ..papers.estimate import wall_minutes
from ..papers.run import study_folder
from ..papers.tally import Progress
from .bars import Verdict, verdicts
from .estimate import expected_seconds
from .job import ControlJob, control_jobs
from .outcome import ControlOutcome
from .pool import kept, run_control_jobs
from .report import control_report
from .settings import ControlSettings


@dataclass(frozen=True, eq=False)
class ControlStudy:
    """The benchmark made ready: its folder is there, nothing has run yet.

    Attributes:
        settings: of the study.
        jobs: all jobs, stage by stage.
        folder: run folder.
        costs: expected seconds by key of all jobs.
        open: keys of the jobs that are not done yet.
    """

    settings: ControlSettings
    jobs: tuple[ControlJob, ...]
    folder: RunFolder
    costs: Mapping[str, float]
    open: frozenset[str]

    def minutes(self, workers: int) -> int:
        """Estimated wall time of the jobs that are not done yet [min]."""
        return wall_minutes({key: self.costs[key] for key in self.open}, workers)


def prepare_control(settings: ControlSettings, out: Path | str) -> ControlStudy:
    """Plan the jobs and open the folder.

    Args:
        settings: of the study.
        out: a new or empty folder, or one in which the benchmark was begun; its finished jobs are kept.

    Raises:
        ConfigError: if the folder holds something else.
        LogError: if a result is damaged.
    """
    jobs = control_jobs(settings)
    folder = study_folder(Path(out), settings)
    done = kept(jobs, settings, folder.path)
    costs = expected_seconds(jobs, settings)
    return ControlStudy(settings, jobs, folder, costs, frozenset(job.key for job in jobs if job.key not in done))


def run_control(study: ControlStudy, workers: int = 1, progress: Progress | None = None) -> ControlOutcome:
    """Do the open jobs and write report, tables and results.

    Args:
        study: made by `prepare_control`.
        workers: processes.
        progress: see `run_control_jobs`.

    Raises:
        ConfigError: if a worker process died.
        LogError: if a result's file is damaged.
        KeyboardInterrupt: if the user ended it; finished jobs are kept, the report is not written.
    """
    folder = study.folder.path
    results = run_control_jobs(study.jobs, study.settings, folder, workers, study.costs, progress)
    outcome = ControlOutcome(study.settings, results, folder, study.folder.meta)
    page, tables = control_report(outcome)
    for table in tables:
        table.save(folder)
    write_atomically(folder / "tables" / "control.json", _plain(outcome, verdicts(outcome)))
    study.folder.write_report(page.html())
    return outcome


def _plain(outcome: ControlOutcome, bars: tuple[Verdict, ...]) -> str:
    """Runs and bars as JSON; what is not there is null."""
    runs = [
        {
            "plant": run.job.plant,
            "rate_hz": run.job.rate_hz,
            "controller": run.job.subject,
            "motion": run.job.motion,
            "figures": {k: v if v == v else None for k, v in run.figures.items()},  # NaN is no JSON
            "ladder": dict(run.ladder),
        }
        for run in outcome.runs
    ]
    failed = {result.job.key: result.message for result in outcome.failed}
    data = {"runs": runs, "bars": [asdict(bar) | {"met": bar.met} for bar in bars], "failed": failed}
    return json.dumps(data, indent=1, allow_nan=False) + "\n"

"""The whole benchmark: jobs, bars, report; in a run folder that the same command goes on from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from hystmpc.trials.types import Progress

from ..ready import ReadyStudy, do_kept, ready_study
from .bars import BarVerdict, ControlOutcome, verdicts
from .controllers import CONTROLLERS
from .job import STAGES, ControlJob, ControlResult, control_jobs, fingerprint, result_files
from .loop import run_along, tune
from .models import save_backlash, save_network
from .plants import PLANTS
from .report import control_report
from .settings import ControlSettings, motion

# Seconds on one core of a two-core x86-64 machine, from runs of the benchmark itself.
_FIXED_S = 0.3
_FIT_S = {"backlash": 3.0}
_UPDATE_S = 0.08
_STEP_S = {"pid": 4e-5, "inverse": 1e-4, "inverse_pid": 1.5e-4, "linearised_mpc": 6e-4, "sampling_mpc": 1e-3}
# An LSTM has kernels of its own; a hybrid goes by onnxruntime and CasADi.
_NETWORK_STEP_S: Mapping[str, Mapping[str, float]] = {
    "lstm": {"linearised_mpc": 3e-3, "sampling_mpc": 2e-2},
    "hb2": {"linearised_mpc": 4e-2, "sampling_mpc": 5e-2},
}
_FAST_HZ, _LONG_HORIZON = 100.0, 3.0


def prepare_control(
    settings: ControlSettings, out: Path | str
) -> ReadyStudy[ControlSettings, ControlJob, ControlResult]:
    """Plan the jobs and open the folder; see `ready_study`."""
    return ready_study(
        settings,
        settings.study,
        control_jobs(settings),
        out,
        result_files,
        lambda job, folder: fingerprint(job, settings, folder),
        lambda jobs: expected_seconds(jobs, settings),
    )


def run_control(
    study: ReadyStudy[ControlSettings, ControlJob, ControlResult], workers: int = 1, progress: Progress | None = None
) -> ControlOutcome:
    """Do the open jobs and write report, tables and results; see `ReadyStudy.complete` for arguments and errors."""
    folder = study.folder.path
    stages = [[job for job in study.jobs if job.stage == stage] for stage in STAGES]
    do = partial(do_job, settings=study.settings, folder=folder)
    results = study.complete(stages, do, workers, progress)
    outcome = ControlOutcome(study.settings, results, folder, study.folder.meta)
    page, tables = control_report(outcome)
    study.leave(page, tables, _plain(outcome, verdicts(outcome)))
    return outcome


def _plain(outcome: ControlOutcome, bars: tuple[BarVerdict, ...]) -> dict[str, Any]:
    """Runs and bars; what is not there is null."""
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
    return {"runs": runs, "bars": [asdict(bar) | {"met": bar.met} for bar in bars], "failed": failed}


def do_job(job: ControlJob, settings: ControlSettings, folder: Path) -> ControlResult:
    """Do one job and write its result; see `do_kept`."""
    blank = ControlResult(job, fingerprint(job, settings, folder), "failed", "", 0.0)
    fields = ("message", "figures", "ladder")
    return do_kept(blank, fields, lambda: _done(job, settings, folder), result_files(folder))


def _done(
    job: ControlJob, settings: ControlSettings, folder: Path
) -> tuple[str, Mapping[str, float], Mapping[str, int]]:
    if job.stage == "run":
        figures, ladder = run_along(job, settings, folder)
        return "", figures, ladder
    if job.stage != "fit":
        message, errors = tune(job, settings, folder)
        return message, errors, {}
    plant, seed = PLANTS[job.plant].nominal(), settings.seed
    if job.subject == "backlash":
        files = save_backlash(plant, folder, settings.rates_hz, seed, settings.quick)
        return f"wrote {', '.join(file.name for file in files)}", {}, {}
    report = save_network(plant, job.subject, folder, settings.network_updates, seed, settings.quick)
    return report, {}, {}


def expected_seconds(jobs: Sequence[ControlJob], settings: ControlSettings) -> Mapping[str, float]:
    """Processor time by key of the job [s]."""
    durations = {name: _duration_s(name, settings) for name in settings.motions}
    return {job.key: _seconds(job, settings, durations) for job in jobs}


def _seconds(job: ControlJob, settings: ControlSettings, durations: Mapping[str, float]) -> float:
    if job.stage == "fit":
        return _FIT_S.get(job.subject, _FIXED_S + _UPDATE_S * settings.network_updates)
    step = _step_s(job)
    if job.stage == "run":
        return _FIXED_S + step * job.rate_hz * durations[job.motion]
    evaluations = settings.tune_evaluations if job.stage == "tune" else settings.retune_evaluations
    return _FIXED_S + evaluations * step * job.rate_hz * sum(durations.values())


def _step_s(job: ControlJob) -> float:
    rival = CONTROLLERS[job.subject]
    step = _NETWORK_STEP_S.get(rival.model, _STEP_S)[rival.kind]
    return step * (_LONG_HORIZON if rival.predictive and job.rate_hz > _FAST_HZ else 1.0)


def _duration_s(name: str, settings: ControlSettings) -> float:
    from hystmpc.trajectories.config import parse_motion

    return parse_motion(motion(name, 40.0, settings.seed, settings.quick)).build().duration_s

"""Study `control`: models, gains, and every controller on every plant along every motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hystmpc.trajectories.config import parse_motion
from hystmpc.trials.json_text import plain

from ..page import StudyTable
from ..study import Study
from .bars import ControlOutcome, verdicts
from .loop import control_jobs, job_inputs, run_along, tune
from .plants import PLANTS, save_backlash, save_network
from .report import bars_table, control_report
from .settings import CONTROLLERS, STAGES, ControlJob, ControlResult, ControlSettings, motion

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


def run_job(job: ControlJob, settings: ControlSettings, folder: Path) -> dict[str, Any]:
    """Execute a job and write its files; return message, figures and sources of the commands."""
    if job.stage == "run":
        figures, ladder = run_along(job, settings, folder)
        return {"figures": figures, "ladder": ladder}
    if job.stage != "fit":
        message, errors = tune(job, settings, folder)
        return {"message": message, "figures": errors}
    plant, seed = PLANTS[job.plant].nominal(), settings.seed
    if job.subject == "backlash":
        files = save_backlash(plant, folder, settings.rates_hz, seed, settings.quick)
        return {"message": f"wrote {', '.join(file.name for file in files)}"}
    return {"message": save_network(plant, job.subject, folder, settings.network_updates, seed, settings.quick)}


def _data(outcome: ControlOutcome) -> dict[str, Any]:
    runs = [
        {
            "plant": run.job.plant,
            "rate_hz": run.job.rate_hz,
            "controller": run.job.subject,
            "motion": run.job.motion,
            "figures": plain(dict(run.figures)),
            "ladder": dict(run.ladder),
        }
        for run in outcome.runs
    ]
    failed = {result.job.key: result.message for result in outcome.failed}
    return {"runs": runs, "bars": [asdict(bar) | {"met": bar.met} for bar in verdicts(outcome)], "failed": failed}


def _summary(outcome: ControlOutcome) -> StudyTable:
    """Bars without the place of their worst figure, which the report contains."""
    judged = bars_table(verdicts(outcome))
    shown = judged.only("Bars", "bar", "at most", "loops that meet it", "loops judged", "worst", "verdict")
    return StudyTable("bars", ("bar", "at most", "met by", "of", "worst", "verdict"), shown.rows, "Bars")


def _costs(jobs: Sequence[ControlJob], settings: ControlSettings) -> Mapping[str, float]:
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
    return parse_motion(motion(name, 40.0, settings.seed, settings.quick)).build().duration_s


STUDY = Study(
    name="control",
    form="hystmpc-control-job/1",
    settings=ControlSettings.of,
    result=ControlResult,
    jobs=control_jobs,
    run=run_job,
    inputs=job_inputs,
    costs=_costs,
    page=control_report,
    data=_data,
    summary=_summary,
    stages=STAGES,
    outcome=ControlOutcome,
)

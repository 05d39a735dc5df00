"""How long the benchmark will take: seconds of plant time, samples, and what a step of each controller costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .job import ControlJob
from .motions import motion
from .rivals import CONTROLLERS
from .settings import ControlSettings

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

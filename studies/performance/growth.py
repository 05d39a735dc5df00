"""Section: how the time of a step grows with horizon, samples and size of the network."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import AnyControllerSettings, LinearisedMpcSettings, SamplingMpcSettings

from .report import Growth
from .scenario import in_turn, record_scan
from .settings import BenchSettings
from .subjects import Subject, lstm_subject
from .timing import Clock, Job

Series = Callable[[BenchSettings, Clock], list[Growth]]
_QUADRATIC = 2.0
_LINEAR = 1.1  # with what the exponent of a finite interval may be off
_LARGEST = 4  # times the benchmark's own size


def _linearised_horizon(settings: BenchSettings, clock: Clock) -> list[Growth]:
    subject, values = lstm_subject(settings.hidden), _doubled(settings.horizon)
    jobs = [_job(subject, LinearisedMpcSettings(horizon=h)) for h in values]
    return _measured(clock, "linearised MPC", "H", values, jobs, _QUADRATIC)


def _sampling_horizon(settings: BenchSettings, clock: Clock) -> list[Growth]:
    subject, values = lstm_subject(settings.hidden), _doubled(settings.horizon)
    jobs = [_job(subject, _sampling(h, settings.samples)) for h in values]
    return _measured(clock, "sampling MPC", "H", values, jobs, _LINEAR)


def _sampling_samples(settings: BenchSettings, clock: Clock) -> list[Growth]:
    subject, values = lstm_subject(settings.hidden), _doubled(settings.samples)
    jobs = [_job(subject, _sampling(settings.horizon, n)) for n in values]
    return _measured(clock, "sampling MPC", "N", values, jobs, _LINEAR)


def _network(settings: BenchSettings, clock: Clock) -> list[Growth]:
    """Both controllers over the width of the network; the operations of a layer grow with its square."""
    values = tuple(v for v in _doubled(settings.hidden) if v <= 2 * settings.hidden)
    subjects = [lstm_subject(hidden) for hidden in values]
    jobs = [_job(subject, LinearisedMpcSettings(horizon=settings.horizon)) for subject in subjects]
    return _measured(clock, "linearised MPC", "hidden", values, jobs, _QUADRATIC)


GROWTHS: Mapping[str, Series] = {
    "growth of the linearised MPC with H": _linearised_horizon,
    "growth of the sampling MPC with H": _sampling_horizon,
    "growth of the sampling MPC with N": _sampling_samples,
    "growth of the linearised MPC with the network": _network,
}


def _doubled(middle: int) -> tuple[int, ...]:
    """Sizes from a quarter of the benchmark's own to four times it, each twice the one before."""
    sizes = [middle * _LARGEST // 2**k for k in range(5)]
    return tuple(sorted({max(size, 4) for size in sizes}))


def _sampling(horizon: int, samples: int) -> SamplingMpcSettings:
    return SamplingMpcSettings(horizon=max(horizon, 6), samples=samples, iterations=1)


def _job(subject: Subject, wanted: AnyControllerSettings) -> Job:
    controller = build_controller(wanted, subject.predictor, subject.inverse, subject.limits)
    instants = record_scan(controller, subject)
    return Job("", in_turn(instants, lambda _, i: controller.step(i.state, i.measured, i.reference)))


def _measured(
    clock: Clock, what: str, size: str, values: tuple[int, ...], jobs: list[Job], goal: float
) -> list[Growth]:
    """The series; none where the keyboard ended it before every size was timed."""
    named = [replace(job, name=str(value)) for job, value in zip(jobs, values, strict=True)]
    times = clock.measure(named)
    if len(times) < len(values):
        return []
    return [Growth(what, size, values, tuple(times[str(v)] for v in values), goal)]

"""Section on the growth of a step's time with horizon, samples and size of the network, and its figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import AnyControllerSettings
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, SamplingMpcSettings

from .report import Growth
from .subjects import BenchSettings, Clock, Subject, TimedCall, in_turn, lstm_subject, record_scan

Series = Callable[[BenchSettings, Clock], list[Growth]]
_QUADRATIC = 2.0
_LINEAR = 1.1  # with what the exponent of a finite interval may be off
_LARGEST = 4  # times the benchmark's own size
_LABELS = {"H": "horizon H [samples]", "N": "plans N", "hidden": "cells in each of two layers"}


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
    """Step times of both controllers over the width of the network; a layer's operations grow with its square."""
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
    """Sizes from a quarter to four times that of the benchmark, each twice the previous one."""
    sizes = [middle * _LARGEST // 2**k for k in range(5)]
    return tuple(sorted({max(size, 4) for size in sizes}))


def _sampling(horizon: int, samples: int) -> SamplingMpcSettings:
    return SamplingMpcSettings(horizon=max(horizon, 6), samples=samples, iterations=1)


def _job(subject: Subject, wanted: AnyControllerSettings) -> TimedCall:
    controller = build_controller(wanted, subject.predictor, subject.inverse, subject.limits)
    instants = record_scan(controller, subject)
    return TimedCall("", in_turn(instants, lambda _, i: controller.step(i.state, i.measured, i.reference)))


def _measured(
    clock: Clock, what: str, size: str, values: tuple[int, ...], jobs: list[TimedCall], goal: float
) -> list[Growth]:
    """Measured series; none if the keyboard ended it before every size was timed."""
    named = [replace(job, name=str(value)) for job, value in zip(jobs, values, strict=True)]
    times = clock.measure(named)
    if len(times) < len(values):
        return []
    return [Growth(what, size, values, tuple(times[str(v)] for v in values), goal)]


def growth_figure(series: Sequence[Growth]) -> Figure:
    """Plot of median and 99th percentile of a step over each size, axes logarithmic, with the exponent."""
    figure = Figure(figsize=(4.0 * len(series), 3.4), layout="constrained")
    for axes, one in zip(figure.subplots(1, len(series), squeeze=False)[0], series, strict=True):
        median, p99, least = ([1e3 * getattr(t, name) for t in one.times] for name in ("median_s", "p99_s", "least_s"))
        axes.loglog(one.values, p99, color="0.7", marker=".", label="p99")
        axes.loglog(one.values, median, color="tab:blue", marker="o", label="median")
        axes.loglog(one.values, least, color="tab:blue", linestyle=":", label="shortest")
        axes.set_title(f"{one.what}: {one.size}^{one.exponent:.2f} at the end")
        axes.set_xlabel(_LABELS[one.size])
        axes.set_ylabel("step [ms]")
        axes.set_xticks(one.values, [str(v) for v in one.values])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    figure.axes[0].legend(frameon=False)
    return figure


def save_growth(series: Sequence[Growth], folder: Path) -> None:
    """Write growth.svg and growth.png into `folder`; no file without a series."""
    if series:
        figure = growth_figure(series)
        for name in ("growth.svg", "growth.png"):
            figure.savefig(folder / name, dpi=150)

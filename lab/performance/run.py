"""Run of all sections of the benchmark."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from hystmpc.trials.types import Progress

from .controllers import linearised_rows, program_rows, sampling_rows
from .growth import GROWTHS
from .kernels import kernel_rows
from .report import BenchReport, Comparison, Growth
from .subjects import BenchSettings, Clock, lstm_subject, operator_subjects, thread_limit

_PACKAGES = ("numpy", "casadi", "osqp", "onnxruntime", "torch", "pytorch-mppi")
_SECTIONS = 8 + len(GROWTHS)


def run_bench(settings: BenchSettings, progress: Progress | None = None) -> BenchReport:
    """Measure every section; after Ctrl-C the report holds the results so far."""
    rows: list[Comparison] = []
    models: dict[str, str] = {}
    growth: list[Growth] = []
    done, title = 0, ""

    def show(rounds: int) -> None:
        nonlocal done
        done += rounds
        if progress is not None:
            progress(done, _SECTIONS * settings.effort.rounds, title)

    clock, surroundings = Clock(settings.effort, show), machine()
    try:
        for name, section in _sections(settings, clock, models):
            title = name
            show(0)
            with thread_limit(1):  # what a section prepares
                rows += section()
            if clock.interrupted:
                break
        for name, series in () if clock.interrupted else GROWTHS.items():
            title = name
            show(0)
            with thread_limit(1):
                growth += series(settings, clock)
    except KeyboardInterrupt:  # between two measurements
        clock.interrupted = True
    return BenchReport(settings.plain(), surroundings, models, rows, clock.interrupted, growth)


def _sections(
    settings: BenchSettings, clock: Clock, models: dict[str, str]
) -> Iterator[tuple[str, Callable[[], list[Comparison]]]]:
    """Titles and measurements; models are built when needed."""
    lstm = lstm_subject(settings.hidden)
    models[lstm.name] = lstm.source
    for threads in (1, 2):
        yield f"kernels, threads: {threads}", partial(kernel_rows, lstm, settings, clock, threads)
    yield "linearised MPC with the LSTM", partial(linearised_rows, lstm, settings, clock)
    for threads in (1, 2):
        yield f"sampling MPC, threads: {threads}", partial(sampling_rows, lstm, settings, clock, threads)
    yield "quadratic programs", partial(program_rows, lstm, settings, clock)
    for subject in operator_subjects():
        models[subject.name] = subject.source
        yield f"linearised MPC with the {subject.name}", partial(linearised_rows, subject, settings, clock)


def _processor() -> str:
    """Name of the processor, as its system gives it."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def machine() -> dict[str, Any]:
    """Processor, cores, their load over the last minute, and versions of the software involved."""
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "processor": _processor(),
        "architecture": platform.machine(),
        "cores": os.cpu_count(),
        "load_at_start": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "versions": versions,
    }

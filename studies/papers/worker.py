"""Doing one job: train, export, score. Pure but for the model file; runs in a process of its own."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import Identified
from hystmpc.trials.errors import HystmpcError, LogError
from hystmpc.trials.trial import Trial

from .job import Task
from .result import JobResult, Score, model_file
from .window_fit import fit_with_window


def run_job(task: Task, folder: Path) -> JobResult:
    """Train, export into `folder`/models and score on every test trial; an error becomes a failed result.

    Raises:
        KeyboardInterrupt: if the user ended it; a model that was cut short is no result.
    """
    start = time.perf_counter()
    job = task.job
    try:
        found = _identified(task)
        if found.interrupted:
            raise KeyboardInterrupt
        path = model_file(folder, job)
        path.parent.mkdir(parents=True, exist_ok=True)
        export_onnx(found.bundle, path)
        scores = tuple(_scores(load_onnx(path), task))
    except HystmpcError as error:
        return _failed(task, str(error), start)
    except Exception as error:  # noqa: BLE001  # one model's defect must not cost the others hours of training
        return _failed(task, f"{type(error).__name__}: {error}", start)
    history = tuple((int(step), float(error)) for step, error in found.history if math.isfinite(error))
    seconds = time.perf_counter() - start
    return JobResult(job, task.fingerprint, "done", found.report, seconds, task.samples, history, scores)


def _identified(task: Task) -> Identified:
    job = task.job
    training, validation = directed(task.training, job.direction), directed(task.validation, job.direction)
    request = replace(job.request, validation=validation)
    if job.window is not None:
        return fit_with_window(job.kind, training, request, job.window)
    return kind_named(job.kind).fit(training, request)


def directed(trials: Iterable[Trial], direction: str) -> tuple[Trial, ...]:
    """The trials as a kind of model is given them: swapped for an inverse map."""
    return tuple(trial.swapped() if direction == "inverse" else trial for trial in trials)


def _scores(model: OnnxModel, task: Task) -> Iterable[Score]:
    for split, trials in task.tests.items():
        for trial in trials:
            later = None
            if task.job.skip_first_flexure:
                try:
                    later = evaluate(model, trial, skip_first_flexure=True).errors
                except LogError:  # a command that never turns has nothing after its first flexure
                    later = None
            yield Score(split, trial.source, evaluate(model, trial).errors, later)


def _failed(task: Task, message: str, start: float) -> JobResult:
    line = " ".join(message.split())
    return JobResult(task.job, task.fingerprint, "failed", line, time.perf_counter() - start, task.samples)

"""One job of a study: expected time, training, export and scores; runs in a process of its own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest, Identified
from hystmpc.models.kinds.networks import NetworkKind
from hystmpc.models.train.networks import fit_network, network_bundle
from hystmpc.models.train.settings import NetworkSettings
from hystmpc.sim.jobs.runner import attempt
from hystmpc.trials.errors import FitError, LogError
from hystmpc.trials.trial import Trial

from ..rivals.forms import FeedForwardSettings
from .job import TrainingTask
from .result import JobResult, Score, model_file, result_files

WINDOWS = {"lstm": (2, 10, 20, 30, 40, 50, 100), "fnn_hib": (1, 2, 10, 20, 30, 40, 50, 100)}
"""Lengths that the code of S2 compares [samples]: of a training window, and of a history buffer."""

_FIXED_S = 3.0  # to load libraries, to export and to compare
_OPERATOR_S_PER_SAMPLE = 5e-4  # least squares on free runs
_SCORING_S_PER_SAMPLE = 8e-5  # a step of a model file by onnxruntime


def fit_with_window(kind: str, trials: Sequence[Trial], request: FitRequest, window: int) -> Identified:
    """Identify with training windows (recurrent networks) or a history buffer (FNN-HIB) of `window` samples.

    Raises:
        FitError: for a kind that has neither, or as its `fit` raises.
    """
    if kind not in WINDOWS:
        raise FitError(f"{kind}: got a window of {window} samples, the window study knows {', '.join(WINDOWS)}")
    network = kind_named(kind)
    assert isinstance(network, NetworkKind)
    settings = windowed(network.training(request), window)
    found = fit_network(trials, settings, None, request.validation)
    history = tuple((look.step, look.validation_rmse_deg) for look in found.history)
    report = f"weights of step {found.best_step} of {settings.steps}, {window} samples"
    return Identified(network_bundle(found, trials, request.limits), None, history, report, found.interrupted)


def windowed(settings: NetworkSettings, window: int) -> NetworkSettings:
    """The settings with a history buffer of another length for a feed-forward network, else with other windows.

    Raises:
        ConfigError: if the length is not possible.
    """
    data = settings.model_dump()
    if isinstance(settings.network, FeedForwardSettings):
        data["network"]["history"] = window
    else:
        data["training"]["length"] = window
    return NetworkSettings.parse(data, f"window of {window} samples")


def do_job(task: TrainingTask, folder: Path) -> JobResult:
    """Train, export into `folder`/models, score on every test trial and write the result; an error is a result too.

    Raises:
        KeyboardInterrupt: if the user ended it; a model that was cut short is no result.
    """
    made = attempt(lambda: _trained(task, folder))
    result = JobResult(task.job, task.fingerprint, "failed", made.error, made.seconds, task.samples)
    if made.value is not None:
        found, scores = made.value
        history = tuple((int(step), float(error)) for step, error in found.history if math.isfinite(error))
        numbers = _numbers(found)
        result = replace(result, status="done", message=found.report, history=history, scores=scores, numbers=numbers)
    result_files(folder).save(result)
    return result


def _trained(task: TrainingTask, folder: Path) -> tuple[Identified, tuple[Score, ...]]:
    found = _identified(task)
    if found.interrupted:
        raise KeyboardInterrupt
    path = model_file(folder, task.job)
    path.parent.mkdir(parents=True, exist_ok=True)
    export_onnx(found.bundle, path)
    return found, tuple(_scores(load_onnx(path), task))


def _numbers(found: Identified) -> int:
    """Numbers that a model holds."""
    if found.simulator is not None:
        return int(found.simulator.chain.values.size)
    graph = found.bundle.graph() if callable(found.bundle.graph) else found.bundle.graph
    return sum(math.prod(tensor.dims) for tensor in graph.initializer)


def _identified(task: TrainingTask) -> Identified:
    job = task.job
    training, validation = directed(task.training, job.direction), directed(task.validation, job.direction)
    request = replace(job.request, validation=validation)
    if job.window is not None:
        return fit_with_window(job.kind, training, request, job.window)
    return kind_named(job.kind).fit(training, request)


def directed(trials: Iterable[Trial], direction: str) -> tuple[Trial, ...]:
    """The trials as a kind of model is given them: swapped for an inverse map."""
    return tuple(trial.swapped() if direction == "inverse" else trial for trial in trials)


def _scores(model: OnnxModel, task: TrainingTask) -> Iterable[Score]:
    for split, trials in task.tests.items():
        for trial in trials:
            later = None
            if task.job.skip_first_flexure:
                try:
                    later = evaluate(model, trial, skip_first_flexure=True, before=task.before).errors
                except LogError:  # a command that never turns has nothing after its first flexure
                    later = None
            yield Score(split, trial.source, evaluate(model, trial, before=task.before).errors, later)


def estimated_seconds(tasks: Sequence[TrainingTask], timed: bool = True) -> dict[str, float]:
    """Processor time by key of the job that each is expected to take on this machine as it is loaded now [s].

    Jobs of one kind, preset and constancy term on about as many samples are timed once.

    Args:
        timed: False to go by the samples alone, without timing anything.
    """
    seconds: dict[tuple[object, ...], float | None] = {}
    found = {}
    for task in tasks:
        job = task.job
        size = round(2 * math.log2(max(task.samples, 1)))  # half octaves
        group = job.kind, job.preset, job.steps, job.window, bool(job.constancy), size
        if timed and group not in seconds:
            seconds[group] = _training_seconds(task)
        training = seconds.get(group)
        found[job.key] = _FIXED_S + _scoring_seconds(task)
        found[job.key] += _OPERATOR_S_PER_SAMPLE * task.samples if training is None else training
    return found


def _training_seconds(task: TrainingTask) -> float | None:
    job = task.job
    trials = directed(task.training, job.direction)
    request = replace(job.request, validation=directed(task.validation, job.direction))
    try:
        return kind_named(job.kind).estimate(trials, request)
    except FitError:  # the job itself will say what is wrong
        return None


def _scoring_seconds(task: TrainingTask) -> float:
    samples = sum(len(trial) for trials in task.tests.values() for trial in trials)
    return _SCORING_S_PER_SAMPLE * samples * (2 if task.job.skip_first_flexure else 1)

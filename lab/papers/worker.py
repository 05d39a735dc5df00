"""One job of a study: expected time, training, export and scores; runs in a process of its own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest, Identified
from hystmpc.models.kinds.networks import NetworkKind
from hystmpc.models.networks.settings import NetworkSettings
from hystmpc.models.train.networks import fit_network, network_bundle
from hystmpc.trials.errors import FitError, LogError
from hystmpc.trials.trial import Trial

from ..rivals.forms import FeedForwardSettings
from .job import TrainingTask
from .result import Score, model_file
from .settings import PaperSettings

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
    trained = fit_network(trials, settings, None, request.validation)
    history = tuple((look.step, look.validation_rmse_deg) for look in trained.history)
    report = f"weights of step {trained.best_step} of {settings.steps}, {window} samples"
    return Identified(network_bundle(trained, trials, request.limits), None, history, report, trained.interrupted)


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


def run_task(task: TrainingTask, settings: PaperSettings, folder: Path) -> dict[str, Any]:
    """Train, export into `folder`/models, score on every test trial; the fields of a `JobResult`.

    Raises:
        KeyboardInterrupt: if the user ended it; a model that was cut short is no result.
    """
    del settings  # the task holds all of them
    made, scores = _trained(task, folder)
    history = tuple((int(step), float(error)) for step, error in made.history if math.isfinite(error))
    return {"message": made.report, "history": history, "scores": scores, "numbers": _numbers(made)}


def _trained(task: TrainingTask, folder: Path) -> tuple[Identified, tuple[Score, ...]]:
    identified = _identified(task)
    if identified.interrupted:
        raise KeyboardInterrupt
    path = model_file(folder, task.job)
    path.parent.mkdir(parents=True, exist_ok=True)
    export_onnx(identified.bundle, path)
    return identified, tuple(_scores(load_onnx(path), task))


def _numbers(identified: Identified) -> int:
    """Numbers that a model holds."""
    if identified.simulator is not None:
        return int(identified.simulator.chain.values.size)
    graph = identified.bundle.graph() if callable(identified.bundle.graph) else identified.bundle.graph
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


def estimated_seconds(tasks: Sequence[TrainingTask], settings: PaperSettings) -> dict[str, float]:
    """Processor time by key of the job that each is expected to take on this machine as it is loaded now [s].

    Jobs of one kind, preset and constancy term on about as many samples are timed once; a quick study goes by the
    samples alone.
    """
    seconds: dict[tuple[object, ...], float | None] = {}
    expected = {}
    for task in tasks:
        job = task.job
        size = round(2 * math.log2(max(task.samples, 1)))  # half octaves
        group = job.kind, job.preset, job.steps, job.window, bool(job.constancy), size
        if not settings.quick and group not in seconds:
            seconds[group] = _training_seconds(task)
        training = seconds.get(group)
        expected[job.key] = _FIXED_S + _scoring_seconds(task)
        expected[job.key] += _OPERATOR_S_PER_SAMPLE * task.samples if training is None else training
    return expected


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

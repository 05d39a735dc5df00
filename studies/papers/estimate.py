"""How long a study will take: every kind of model times a few of its steps, operators go by their samples."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.trials.errors import FitError

from .job import Task
from .worker import directed

_FIXED_S = 3.0  # to load libraries, to export and to compare
_OPERATOR_S_PER_SAMPLE = 5e-4  # least squares on free runs
_SCORING_S_PER_SAMPLE = 8e-5  # a step of a model file by onnxruntime


def estimated_seconds(tasks: Sequence[Task], timed: bool = True) -> dict[str, float]:
    """Processor time by key of the job that each is expected to take on this machine as it is loaded now [s].

    Jobs of one kind, preset and constancy term on about as many samples are timed once.

    Args:
        tasks: of a study.
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


def wall_minutes(seconds: Mapping[str, float], workers: int) -> int:
    """Wall time of all jobs on so many workers, rounded up; never less than the longest job [min]."""
    longest = max(seconds.values(), default=0.0)
    return math.ceil(max(sum(seconds.values()) / workers, longest) / 60)


def _training_seconds(task: Task) -> float | None:
    job = task.job
    trials = directed(task.training, job.direction)
    request = replace(job.request, validation=directed(task.validation, job.direction))
    try:
        return kind_named(job.kind).estimate(trials, request)
    except FitError:  # the job itself will say what is wrong
        return None


def _scoring_seconds(task: Task) -> float:
    samples = sum(len(trial) for trials in task.tests.values() for trial in trials)
    return _SCORING_S_PER_SAMPLE * samples * (2 if task.job.skip_first_flexure else 1)

"""Jobs of a study: a model to be trained, exported and scored, the trials, and the fingerprint of both."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.identify.runs import fingerprint
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.read import expand_logs, read_trials
from hystmpc.trials.trial import Trial, resample

from .settings import NETWORKS, PAPER_PRESETS, QUICK_SCALE, DirectionName, PaperSettings

Splits = Mapping[str, tuple[Trial, ...]]
LOGS = "logs"
"""The one split of the study on recorded logs."""
_FEWEST_LOGS = 2
_QUICK_TRIALS = {"train": 2, "val": 1, "test": 3}
_QUICK_SAMPLES, _QUICK_S = 600, 5.0  # whichever is longer: a command has to turn in it


@dataclass(frozen=True)
class TrainingJob:
    """A training; with the trials of its `TrainingTask` it determines the result.

    Attributes:
        direction: `inverse` swaps command and angle of every trial.
        train: name of the training set: `sin`, `p2p`, `mixed`, `train`, or the log that is left out.
        constancy: beta of S2 eq. (12), None for the preset's.
        steps: epochs, updates or iterations; None for the preset's.
        skip_first_flexure: train without the first flexure, score with and without it.
        window: samples of a training window or a history buffer, see `WINDOWS`; None for the preset's.
    """

    stage: str
    kind: str
    preset: str
    direction: DirectionName
    train: str
    constancy: float | None
    seed: int
    steps: int | None
    skip_first_flexure: bool = False
    window: int | None = None

    @property
    def key(self) -> str:
        """Name of the job's files: unique in a study."""
        parts = [self.stage, self.kind, self.preset, self.direction, re.sub(r"[^\w.]+", "_", self.train)]
        parts += [] if self.constancy is None else [f"b{self.constancy:g}"]
        parts += [] if self.window is None else [f"w{self.window}"]
        return "-".join([*parts, f"s{self.seed}"])

    @property
    def request(self) -> FitRequest:
        """The job as a kind of model is asked; validation trials are added by the worker."""
        return FitRequest(
            training=self.preset,
            seed=self.seed,
            steps=self.steps,
            constancy_weight=self.constancy,
            skip_first_flexure=self.skip_first_flexure,
        )


@dataclass(frozen=True, eq=False)
class TrainingTask:
    """A job with its trials, command to angle whatever the job's direction.

    Attributes:
        before: what the one test trial's log holds before it, see `before`.
    """

    job: TrainingJob
    training: tuple[Trial, ...]
    validation: tuple[Trial, ...]
    tests: Splits
    before: Trial | None = None

    @property
    def key(self) -> str:
        """Key of the job."""
        return self.job.key

    @property
    def samples(self) -> int:
        """Samples to train on."""
        return sum(len(trial) for trial in self.training)

    @property
    def inputs(self) -> list[Any]:
        """All that the result depends on: the job's settings and all its trials."""
        parts = {"training": self.training, "validation": self.validation} | dict(self.tests)
        parts |= {"before": (self.before,)} if self.before else {}
        hashes = {name: fingerprint(trials) for name, trials in parts.items()}
        names = {name: [trial.source for trial in trials] for name, trials in parts.items()}
        return [asdict(self.job), hashes, names]


def preset_for(kind: str, asked: str, paper: str = "paper") -> str:
    """The preset asked for, or the kind's first where it has none of that name.

    `paper` is the name of the preset that this study's paper has trained with, taken where `paper` is asked for.
    """
    presets = kind_named(kind).trainings
    wanted = paper if asked == "paper" and paper in presets else asked
    return wanted if wanted in presets else presets[0]


def betas_for(kind: str, preset: str, settings: PaperSettings) -> tuple[float | None, ...]:
    """Weights of the constancy term to train with: those of the study for networks as in the paper, else none."""
    return settings.betas if kind in NETWORKS and preset in PAPER_PRESETS else (None,)


def steps_for(kind: str, preset: str, settings: PaperSettings) -> int | None:
    """Steps of a training, None for the preset's.

    `epochs_scale` is for networks with a paper's preset; `quick` cuts everything that counts its steps.
    """
    steps = kind_named(kind).steps(FitRequest(training=preset))
    if steps is None:
        return None
    if settings.quick:
        return max(1, round(steps * QUICK_SCALE))
    scaled = kind in NETWORKS and preset in PAPER_PRESETS and settings.epochs_scale != 1.0
    return max(1, round(steps * settings.epochs_scale)) if scaled else None


def study_splits(settings: PaperSettings) -> Splits:
    """Trials by split: those of `datasets.make_dataset` for `s1` and `s2`, one split `logs` for `real`.

    Raises:
        ConfigError: if fewer than two logs are given, or two of them are the same.
        LogError: if a log cannot be read or resampled.
    """
    splits: Mapping[str, tuple[Trial, ...]]
    if settings.study == "real":
        splits = {LOGS: _logs(settings)}
    else:
        from ..datasets import make_dataset  # compiles its devices

        splits = make_dataset(settings.study, settings.seed).splits
    return {name: _shortened(name, trials) for name, trials in splits.items()} if settings.quick else dict(splits)


def _logs(settings: PaperSettings) -> tuple[Trial, ...]:
    logs = expand_logs(settings.logs)
    twice = [log for log in logs if logs.count(log) > 1]
    if twice:
        raise ConfigError(f"study real: {twice[0]} is given twice, expected each log once")
    whole = (resample(t, settings.rate_hz) for t in read_trials(settings.logs, settings.layout))
    trials = tuple(part for trial in whole for part in _parts(trial, settings.parts))
    sources = [trial.source for trial in trials]
    if len(sources) < _FEWEST_LOGS:
        raise ConfigError(f"study real: got {len(sources)} log, expected at least two: each is tested on the others")
    return trials


def _parts(trial: Trial, count: int) -> list[Trial]:
    """Equal parts of a trial, each with a name of its own."""
    if count == 1:
        return [trial]
    edges, path = [len(trial) * k // count for k in range(count + 1)], Path(trial.source)
    return [
        replace(trial.select(start, stop), source=str(path.with_stem(f"{path.stem}_part{k + 1}")))
        for k, (start, stop) in enumerate(pairwise(edges))
    ]


def before(trial: Trial, logs: Sequence[Trial], parts: int) -> Trial | None:
    """What was recorded before a trial that is one of several parts of a log; None before the first part."""
    at = next(k for k, log in enumerate(logs) if log is trial)
    earlier = logs[at - at % parts : at]
    if not earlier:
        return None
    t, command, angle = (np.concatenate([getattr(log, name) for log in earlier]) for name in ("t", "command", "angle"))
    return Trial(t, command, angle, units=trial.units, source=trial.source)


def _shortened(split: str, trials: tuple[Trial, ...]) -> tuple[Trial, ...]:
    """A few trials of their first samples."""
    part = split.rpartition("/")[2]
    count = _QUICK_TRIALS.get(part, len(trials) if part != LOGS else 3)
    return tuple(trial.select(0, max(_QUICK_SAMPLES, round(_QUICK_S / trial.dt))) for trial in trials[:count])

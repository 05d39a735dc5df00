"""One job of a study: a model to be trained, exported and scored, and all that its result depends on."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from hystmpc.models.identify.trial_set import fingerprint
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.trials.trial import Trial

from .settings import NETWORKS, PAPER_PRESETS, QUICK_SCALE, DirectionName, StudySettings

Splits = Mapping[str, tuple[Trial, ...]]


@dataclass(frozen=True)
class Job:
    """What is trained; with the trials of its `Task` it determines the result.

    Attributes:
        stage: part of the study.
        kind, preset: of the model and its training.
        direction: `inverse` swaps command and angle of every trial.
        train: name of the training set: `sin`, `p2p`, `mixed`, `train`, or the log that is left out.
        constancy: beta of S2 eq. (12), None for the preset's.
        seed: of the training.
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
            preset=self.preset,
            seed=self.seed,
            steps=self.steps,
            constancy_weight=self.constancy,
            skip_first_flexure=self.skip_first_flexure,
        )


@dataclass(frozen=True, eq=False)
class Task:
    """A job with its trials, command to angle whatever the job's direction.

    Attributes:
        job: what is trained.
        training, validation: trials to learn from and to stop by.
        tests: trials to score, by split.
    """

    job: Job
    training: tuple[Trial, ...]
    validation: tuple[Trial, ...]
    tests: Splits

    @property
    def samples(self) -> int:
        """Samples to train on."""
        return sum(len(trial) for trial in self.training)

    @property
    def fingerprint(self) -> str:
        """SHA-256 over the job's settings and all its trials: a result with the same one need not be computed again."""
        parts = {"training": self.training, "validation": self.validation} | dict(self.tests)
        hashes = {name: fingerprint(trials) for name, trials in parts.items()}
        names = {name: [trial.source for trial in trials] for name, trials in parts.items()}
        text = json.dumps([asdict(self.job), hashes, names], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def preset_for(kind: str, asked: str, paper: str = "paper") -> str:
    """The preset asked for, or the kind's first where it has none of that name.

    `paper` is the name of the preset that this study's paper has trained with, taken where `paper` is asked for.
    """
    presets = kind_named(kind).presets
    wanted = paper if asked == "paper" and paper in presets else asked
    return wanted if wanted in presets else presets[0]


def betas_for(kind: str, preset: str, settings: StudySettings) -> tuple[float | None, ...]:
    """Weights of the constancy term to train with: those of the study for networks as in the paper, else none."""
    return settings.betas if kind in NETWORKS and preset in PAPER_PRESETS else (None,)


def steps_for(kind: str, preset: str, settings: StudySettings) -> int | None:
    """Steps of a training, None for the preset's.

    `epochs_scale` is for networks with a paper's preset; `quick` cuts everything that counts its steps.
    """
    steps = kind_named(kind).steps(FitRequest(preset=preset))
    if steps is None:
        return None
    if settings.quick:
        return max(1, round(steps * QUICK_SCALE))
    scaled = kind in NETWORKS and preset in PAPER_PRESETS and settings.epochs_scale != 1.0
    return max(1, round(steps * settings.epochs_scale)) if scaled else None

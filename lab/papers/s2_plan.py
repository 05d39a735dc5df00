"""Jobs of the study of S2, and their results grouped by motion, direction and preset."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hystmpc.trials.types import Vec

from ..statistics import SignedRank, pairwise
from .job import Splits, TrainingJob, TrainingTask, betas_for, preset_for, steps_for
from .result import JobResult, StudyOutcome
from .settings import StudySettings
from .worker import WINDOWS

MOTIONS = ("sin", "p2p")
TRAINING_SETS = {"sin": ("sin",), "p2p": ("p2p",), "mixed": MOTIONS}
MOTION_NAMES = {"sin": "sinusoids", "p2p": "point-to-point"}
UNITS = {"forward": "deg", "inverse": "mm"}
BASELINE = "fnn"


def split_tested_on(motion: str) -> str:
    """Split that a motion is tested on."""
    return f"{motion}/test"


def s2_tasks(settings: StudySettings, splits: Splits) -> tuple[TrainingTask, ...]:
    """Every model on each motion (`main`), on both together (`cross`), and with other windows (`window`).

    Everything is tested on both motions. Mixed training has the last beta alone: what it is for, holds, is in the data.
    """
    jobs: list[TrainingJob] = []
    if "main" in settings.stages:
        jobs += [job for train in MOTIONS for job in _jobs(settings, "main", train, settings)]
    if "cross" in settings.stages:
        one = settings.model_copy(update={"betas": settings.betas[-1:]})
        jobs += _jobs(settings, "cross", "mixed", one)
    if "window" in settings.stages:
        jobs += _window_jobs(settings)
    return tuple(_task(job, splits) for job in jobs)


def _jobs(settings: StudySettings, stage: str, train: str, betas: StudySettings) -> Iterator[TrainingJob]:
    kinds = [kind for kind in settings.kinds if kind not in settings.left_out]
    for kind in kinds:
        for preset in dict.fromkeys(preset_for(kind, asked) for asked in settings.presets):
            steps = steps_for(kind, preset, settings)
            for direction in settings.directions:
                for beta in betas_for(kind, preset, betas):
                    yield TrainingJob(stage, kind, preset, direction, train, beta, settings.seed, steps)


def _window_jobs(settings: StudySettings) -> Iterator[TrainingJob]:
    """Forward, sinusoids, beta 0: as the published code's numbers are."""
    for kind, windows in WINDOWS.items():
        if kind in settings.kinds and kind not in settings.left_out:
            steps = steps_for(kind, "paper", settings)
            for window in windows:
                yield TrainingJob("window", kind, "paper", "forward", "sin", 0.0, settings.seed, steps, window=window)


def _task(job: TrainingJob, splits: Splits) -> TrainingTask:
    parts = TRAINING_SETS[job.train]
    training = tuple(trial for part in parts for trial in splits[f"{part}/train"])
    validation = tuple(trial for part in parts for trial in splits[f"{part}/val"])
    return TrainingTask(
        job, training, validation, {split_tested_on(motion): splits[split_tested_on(motion)] for motion in MOTIONS}
    )


@dataclass(frozen=True, eq=False)
class Matched:
    """The models that were trained and tested on one motion, in one direction, with one preset."""

    outcome: StudyOutcome
    motion: str
    direction: str
    preset: str

    @cached_property
    def results(self) -> dict[str, JobResult]:
        """The better of both betas, by kind."""
        wanted = {"stage": "main", "direction": self.direction, "preset": self.preset, "train": self.motion}
        split = [split_tested_on(self.motion)]
        found = {kind: self.outcome.better(split, kind=kind, **wanted) for kind in self.outcome.kinds}
        return {kind: result for kind, result in found.items() if result is not None}

    def errors(self, kind: str, name: str = "rmse_deg") -> Vec:
        """One figure a test trial (N,)."""
        return self.results[kind].figures(name, [split_tested_on(self.motion)])

    def other_betas(self, kind: str) -> str:
        """Mean RMSE of the models that were not chosen, as text."""
        chosen, split = self.results[kind], [split_tested_on(self.motion)]
        wanted = {"stage": "main", "kind": kind, "direction": self.direction, "preset": self.preset}
        others = [r for r in self.outcome.matching(train=self.motion, **wanted) if r is not chosen]
        means = [f"{np.mean(r.figures('rmse_deg', split)):.4g} (beta {r.job.constancy:g})" for r in others]
        return ", ".join(means) or "-"

    @property
    def tests(self) -> tuple[SignedRank, ...]:
        """Signed-rank tests of the RMSE, models in the order of the paper's table."""
        return pairwise({kind: self.errors(kind) for kind in self.results})

    @property
    def suffix(self) -> str:
        """End of a table's name."""
        return f"{self.direction}_{self.motion}_{self.preset}"

    @property
    def where(self) -> str:
        """For captions."""
        return f"{self.direction} map, {MOTION_NAMES[self.motion]}, preset {self.preset}"


def matched(outcome: StudyOutcome) -> list[Matched]:
    """Every combination that has results."""
    views = [
        Matched(outcome, motion, direction, preset)
        for preset in outcome.presets
        for direction in outcome.settings.directions
        for motion in MOTIONS
    ]
    return [view for view in views if view.results]

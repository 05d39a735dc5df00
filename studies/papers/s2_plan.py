"""Which jobs the study of S2 has."""

from __future__ import annotations

from collections.abc import Iterator

from .job import Job, Splits, Task, betas_for, preset_for, steps_for
from .settings import StudySettings
from .window_fit import WINDOWS

MOTIONS = ("sin", "p2p")
TRAINING_SETS = {"sin": ("sin",), "p2p": ("p2p",), "mixed": MOTIONS}


def split_tested_on(motion: str) -> str:
    """Split that a motion is tested on."""
    return f"{motion}/test"


def s2_tasks(settings: StudySettings, splits: Splits) -> tuple[Task, ...]:
    """Every model on each motion (`main`), on both together (`cross`), and with other windows (`window`).

    Everything is tested on both motions. Mixed training has the last beta alone: what it is for, holds, is in the data.
    """
    jobs: list[Job] = []
    if "main" in settings.stages:
        jobs += [job for train in MOTIONS for job in _jobs(settings, "main", train, settings)]
    if "cross" in settings.stages:
        one = settings.model_copy(update={"betas": settings.betas[-1:]})
        jobs += _jobs(settings, "cross", "mixed", one)
    if "window" in settings.stages:
        jobs += _window_jobs(settings)
    return tuple(_task(job, splits) for job in jobs)


def _jobs(settings: StudySettings, stage: str, train: str, betas: StudySettings) -> Iterator[Job]:
    kinds = [kind for kind in settings.kinds if kind not in settings.left_out]
    for kind in kinds:
        for preset in dict.fromkeys(preset_for(kind, asked) for asked in settings.presets):
            steps = steps_for(kind, preset, settings)
            for direction in settings.directions:
                for beta in betas_for(kind, preset, betas):
                    yield Job(stage, kind, preset, direction, train, beta, settings.seed, steps)


def _window_jobs(settings: StudySettings) -> Iterator[Job]:
    """Forward, sinusoids, beta 0: as the published code's numbers are."""
    for kind, windows in WINDOWS.items():
        if kind in settings.kinds and kind not in settings.left_out:
            steps = steps_for(kind, "paper", settings)
            for window in windows:
                yield Job("window", kind, "paper", "forward", "sin", 0.0, settings.seed, steps, window=window)


def _task(job: Job, splits: Splits) -> Task:
    parts = TRAINING_SETS[job.train]
    training = tuple(trial for part in parts for trial in splits[f"{part}/train"])
    validation = tuple(trial for part in parts for trial in splits[f"{part}/val"])
    return Task(
        job, training, validation, {split_tested_on(motion): splits[split_tested_on(motion)] for motion in MOTIONS}
    )

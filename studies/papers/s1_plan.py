"""Which jobs the study of S1 has."""

from __future__ import annotations

from .job import Job, Splits, Task, preset_for, steps_for
from .settings import StudySettings

TESTS = {
    "test_a": "(a) descending sine",
    "test_b": "(b) down-chirp, shifted baseline",
    "test_c": "(c) up-chirp, zero baseline",
    "test_d": "(d) arbitrary with plateaus",
}
S1_PRESET = "s1"


def s1_tasks(settings: StudySettings, splits: Splits) -> tuple[Task, ...]:
    """Every model on the eight training groups, tested on (a) to (d).

    Networks are trained with their preset `s1` where `paper` is asked for. S1 knows no constant-in, constant-out term.
    """
    tasks = []
    for kind in (kind for kind in settings.kinds if kind not in settings.left_out):
        for preset in dict.fromkeys(preset_for(kind, asked, S1_PRESET) for asked in settings.presets):
            steps = steps_for(kind, preset, settings)
            for direction in settings.directions:
                job = Job("main", kind, preset, direction, "train", None, settings.seed, steps)
                tasks.append(Task(job, splits["train"], (), {test: splits[test] for test in TESTS}))
    return tuple(tasks)

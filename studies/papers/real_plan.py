"""Which jobs the study on recorded logs has: every log is tested by models that have not seen it."""

from __future__ import annotations

from pathlib import Path

from .datasets import LOGS
from .job import Job, Splits, Task, betas_for, preset_for, steps_for
from .settings import StudySettings

BASELINE = "backlash"


def real_tasks(settings: StudySettings, splits: Splits) -> tuple[Task, ...]:
    """Leave-one-trial-out over the logs, for every kind, preset and direction; training skips the first flexure.

    The backlash is always among the kinds: the others are measured against it.
    """
    names = [kind for kind in settings.kinds if kind not in settings.left_out]
    kinds = dict.fromkeys([BASELINE, *names])
    logs, tasks = splits[LOGS], []
    for kind in kinds:
        for preset in dict.fromkeys(preset_for(kind, asked) for asked in settings.presets):
            steps = steps_for(kind, preset, settings)
            for direction in settings.directions:
                for beta in betas_for(kind, preset, settings):
                    for k, held_out in enumerate(logs):
                        fold = f"{k + 1}_{Path(held_out.source).stem}"
                        job = Job(
                            "main", kind, preset, direction, fold, beta, settings.seed, steps, skip_first_flexure=True
                        )
                        others = tuple(log for log in logs if log is not held_out)
                        tasks.append(Task(job, others, (), {LOGS: (held_out,)}))
    return tuple(tasks)

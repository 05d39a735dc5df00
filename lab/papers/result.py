"""Results of a study's jobs, one by one as files and all together for its report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.evaluate import Errors, TrialEvaluation, evaluate
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.sim.jobs.runner import ResultFiles, Status
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .job import LOGS, Splits, TrainingJob, before
from .settings import StudySettings

FORMAT = "hystmpc-study-job/1"


@dataclass(frozen=True)
class Score:
    """A model's free run over one trial.

    Attributes:
        errors: over the whole trial; in mm or bar for an inverse map.
        later: over the trial from the first reversal of the command on; None where that was not asked for, or the
            command never turns.
    """

    split: str
    trial: str
    errors: Errors
    later: Errors | None = None


@dataclass(frozen=True)
class JobResult:
    """Outcome of one job.

    Attributes:
        status: `failed` if the kind, the export or the free runs raised.
        message: the error of a failed job, else the fit's own report.
        history: step and best error so far, in the unit of the output.
        numbers: that the model holds: parameters of operators, weights of a network; 0 in older results.
    """

    job: TrainingJob
    fingerprint: str
    status: Status
    message: str
    seconds: float
    samples: int
    history: tuple[tuple[int, float], ...] = ()
    scores: tuple[Score, ...] = ()
    numbers: int = 0

    def of_split(self, split: str) -> tuple[Score, ...]:
        """Scores of one split, in the order of its trials."""
        return tuple(score for score in self.scores if score.split == split)

    def figures(self, name: str, splits: Iterable[str]) -> Vec:
        """One figure of `Errors` over all trials of some splits, (N,)."""
        return np.array([getattr(score.errors, name) for split in splits for score in self.of_split(split)])


def result_files(folder: Path) -> ResultFiles[JobResult]:
    """Results of a study's folder."""
    return ResultFiles(folder, JobResult, FORMAT)


def model_file(folder: Path, job: TrainingJob) -> Path:
    """File of a job's model."""
    return folder / "models" / f"{job.key}.onnx"


@dataclass(frozen=True, eq=False)
class StudyOutcome:
    """A study with the results of all its jobs."""

    settings: StudySettings
    splits: Splits
    results: tuple[JobResult, ...]
    folder: Path
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def done(self) -> tuple[JobResult, ...]:
        """Results that hold scores."""
        return tuple(result for result in self.results if result.status == "done")

    @property
    def failed(self) -> tuple[JobResult, ...]:
        """Results that hold an error."""
        return tuple(result for result in self.results if result.status == "failed")

    @property
    def presets(self) -> tuple[str, ...]:
        """Presets that models were trained with, in order."""
        return tuple(dict.fromkeys(result.job.preset for result in self.results))

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of model with any result, in the order of the settings."""
        here = {result.job.kind for result in self.done}
        return (*(k for k in self.settings.kinds if k in here), *sorted(here - set(self.settings.kinds)))

    def matching(self, **wanted: object) -> tuple[JobResult, ...]:
        """Done jobs whose settings are these, such as `kind="lstm", direction="forward"`."""
        return tuple(r for r in self.done if all(getattr(r.job, name) == value for name, value in wanted.items()))

    def better(self, splits: Sequence[str], **wanted: object) -> JobResult | None:
        """Of the matching jobs, which differ in beta, the one with the lowest mean RMSE over the trials of some splits.

        This is the paper's rule ("the model with lowest error is reported"): it chooses by test trials.
        """
        found = [result for result in self.matching(**wanted) if result.figures("rmse_deg", splits).size]
        return min(found, key=lambda r: float(np.mean(r.figures("rmse_deg", splits))), default=None)

    def model(self, job: TrainingJob) -> OnnxModel:
        """The model that a job left.

        Raises:
            ModelError: if it is gone or damaged.
        """
        return load_onnx(model_file(self.folder, job))

    def free_run(self, job: TrainingJob, trial: Trial) -> TrialEvaluation:
        """Free run of a job's model over a trial, swapped by itself for an inverse map.

        Raises:
            ModelError: if the model is gone or damaged.
        """
        logs = self.splits.get(LOGS)
        earlier = before(trial, logs, self.settings.parts) if logs else None
        return evaluate(self.model(job), trial, before=earlier)


def title_of(kind: str) -> str:
    """A kind's name in tables."""
    return kind_named(kind).title

"""What a job found, as a file that a study goes on from."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hystmpc.models.evaluate import Errors
from hystmpc.trials.errors import LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

from .job import Job

FORMAT = "hystmpc-study-job/1"


@dataclass(frozen=True)
class Score:
    """A model's free run over one trial.

    Attributes:
        split: of the data set.
        trial: its source.
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
    """What became of one job.

    Attributes:
        job: what was asked.
        fingerprint: of job and trials.
        status: `failed` if the kind, the export or the free runs raised.
        message: the error of a failed job, else the fit's own report.
        seconds: wall time of the job.
        samples: trained on.
        history: step and best error so far, in the unit of the output.
        scores: a free run each.
    """

    job: Job
    fingerprint: str
    status: Literal["done", "failed"]
    message: str
    seconds: float
    samples: int
    history: tuple[tuple[int, float], ...] = ()
    scores: tuple[Score, ...] = ()

    def of_split(self, split: str) -> tuple[Score, ...]:
        """Scores of one split, in the order of its trials."""
        return tuple(score for score in self.scores if score.split == split)

    def figures(self, name: str, splits: Iterable[str]) -> Vec:
        """One figure of `Errors` over all trials of some splits, (N,)."""
        return np.array([getattr(score.errors, name) for split in splits for score in self.of_split(split)])


def result_path(folder: Path, job: Job) -> Path:
    """File of a job's result."""
    return folder / "results" / f"{job.key}.json"


def model_file(folder: Path, job: Job) -> Path:
    """File of a job's model."""
    return folder / "models" / f"{job.key}.onnx"


def save_result(folder: Path, result: JobResult) -> Path:
    """Write a result, whole or not at all."""
    return write_atomically(
        result_path(folder, result.job), json.dumps({"format": FORMAT} | asdict(result), indent=1) + "\n"
    )


def load_result(folder: Path, job: Job) -> JobResult | None:
    """The result of a job, None where there is none yet.

    Raises:
        LogError: if the file is not a result.
    """
    path = result_path(folder, job)
    if not path.exists():
        return None
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data.pop("format") != FORMAT:
            raise LogError(f"{path}: not of the format {FORMAT}; remove it to have the job done again")
        return _result(data)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise LogError(f"{path}: not a result of a study ({error}); remove it to have the job done again") from None


def _result(data: dict[str, Any]) -> JobResult:
    scores = tuple(
        Score(s["split"], s["trial"], Errors(**s["errors"]), Errors(**s["later"]) if s["later"] else None)
        for s in data.pop("scores")
    )
    history = tuple((int(step), float(error)) for step, error in data.pop("history"))
    return JobResult(job=Job(**data.pop("job")), history=history, scores=scores, **data)

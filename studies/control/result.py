"""What a job of the benchmark found, as files that it goes on from."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hystmpc.trials.errors import LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

from .job import ControlJob

FORMAT = "hystmpc-control-job/1"
SIGNALS = ("time_s", "reference_deg", "true_deg", "command")


@dataclass(frozen=True)
class ControlResult:
    """What became of one job.

    Attributes:
        job: what was asked.
        fingerprint: of all that the result depends on.
        status: `failed` if anything raised.
        message: the error of a failed job, else one line on how it went.
        seconds: wall time of the job.
        figures: of a run, see `control_figures_of`; of a search its error; NaN where there is none.
        ladder: of a run, samples by source of the command.
    """

    job: ControlJob
    fingerprint: str
    status: Literal["done", "failed"]
    message: str
    seconds: float
    figures: Mapping[str, float] = field(default_factory=dict)
    ladder: Mapping[str, int] = field(default_factory=dict)


def result_file(folder: Path, job: ControlJob) -> Path:
    """File of a job's result."""
    return folder / "results" / f"{job.key}.json"


def signals_file(folder: Path, job: ControlJob) -> Path:
    """File of a run's signals."""
    return folder / "runs" / f"{job.key}.npz"


def save(folder: Path, result: ControlResult) -> Path:
    """Write a result, whole or not at all; figures that are not there are null."""
    plain = asdict(result)
    plain["figures"] = {k: v if math.isfinite(v) else None for k, v in result.figures.items()}
    text = json.dumps({"format": FORMAT} | plain, indent=1, allow_nan=False)
    return write_atomically(result_file(folder, result.job), text + "\n")


def load(folder: Path, job: ControlJob) -> ControlResult | None:
    """The result of a job, None where there is none yet.

    Raises:
        LogError: if the file is not a result.
    """
    path = result_file(folder, job)
    if not path.exists():
        return None
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if data.pop("format") != FORMAT:
            raise LogError(f"{path}: not of the format {FORMAT}; remove it to have the job done again")
        figures = {k: math.nan if v is None else float(v) for k, v in data.pop("figures").items()}
        return ControlResult(job=ControlJob(**data.pop("job")), figures=figures, **data)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise LogError(f"{path}: not a result of a study ({error}); remove it to have the job done again") from None


def save_signals(folder: Path, job: ControlJob, signals: Mapping[str, Vec]) -> Path:
    """Write the signals (N,) of a run in single precision, enough for figures."""
    out = io.BytesIO()
    time_s, reference, true, command = (np.asarray(signals[name], dtype=np.float32) for name in SIGNALS)
    np.savez_compressed(out, time_s=time_s, reference_deg=reference, true_deg=true, command=command)
    return write_atomically(signals_file(folder, job), out.getvalue())


def load_signals(folder: Path, job: ControlJob) -> dict[str, Vec]:
    """The signals (N,) of a run.

    Raises:
        LogError: if they are gone or damaged.
    """
    path = signals_file(folder, job)
    try:
        with np.load(path) as stored:
            return {name: stored[name].astype(np.float64) for name in SIGNALS}
    except (OSError, ValueError, KeyError) as error:
        raise LogError(f"{path}: no signals of a run ({error}); remove its result to have it done again") from None

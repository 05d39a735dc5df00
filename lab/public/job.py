"""One kind of model on one case of a public data set: identified from its trials, scored on its test."""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.evaluate import free_run
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.simulator import ChainModel, load_simulator, save_simulator
from hystmpc.sim.jobs.runner import ResultFiles, Status
from hystmpc.trials.types import Vec

from .catalogue import data_set
from .records import Case, ScoredRecord
from .settings import PublicSettings

FORMAT = "hystmpc-public-job/2"
_LAPS = 3  # passes over a period: the first two end the transient


@dataclass(frozen=True)
class PublicJob:
    """One kind of model on one case."""

    case: str
    kind: str

    @property
    def key(self) -> str:
        """Name of its files."""
        words = re.sub(r"[^A-Za-z0-9.]+", "-", self.case).strip("-")
        return f"{words}-{self.kind}" if words else self.kind


@dataclass(frozen=True)
class Score:
    """Errors of a free run over one record, in the unit of the data set.

    Attributes:
        rmse: root mean square error.
        spread: the same less the mean error.
        span: range of the measured output where it counts.
    """

    rmse: float
    spread: float
    span: float


@dataclass(frozen=True)
class PublicResult:
    """Outcome of one kind on one case.

    Attributes:
        status: `failed` if anything raised.
        message: the error of a failed job, else how the identification went.
        fit_s: time of the identification [s].
        parameters: values of its readable form, with their labels; nothing of a network.
        scores: by test record.
    """

    job: PublicJob
    fingerprint: str
    status: Status
    message: str
    seconds: float
    fit_s: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    scores: Mapping[str, Score] = field(default_factory=dict)


def public_jobs(settings: PublicSettings, cases: Sequence[Case]) -> tuple[PublicJob, ...]:
    """A job for each case and kind."""
    return tuple(PublicJob(case.name, kind) for case in cases for kind in dict.fromkeys(settings.kinds))


def fingerprint(job: PublicJob, settings: PublicSettings) -> str:
    """SHA-256 over the settings and the files."""
    files = [hashlib.sha256(path.read_bytes()).hexdigest() for path in data_set(settings).files(settings)]
    own = settings.model_dump(mode="json") | {"kinds": job.kind, "data": job.case, "test": files}
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()


def result_files(folder: Path) -> ResultFiles[PublicResult]:
    """Results of the study's folder."""
    return ResultFiles(folder, PublicResult, FORMAT)


def study_kind(
    job: PublicJob, settings: PublicSettings, folder: Path
) -> tuple[str, float, dict[str, float], dict[str, Score]]:
    """Identify and score; the model is written into the folder.

    Returns:
        Message, time of the identification [s], parameters and scores, see `PublicResult`.

    Raises:
        HystmpcError: if a file cannot be used, or the kind cannot be identified from it.
    """
    kind = kind_named(job.kind)
    case = next(case for case in data_set(settings).cases(settings) if case.name == job.case)
    request = FitRequest(kind.usual_training(False), settings.seed, settings.steps(job.kind))
    start = time.perf_counter()
    found = kind.fit(case.training, request)
    seconds = time.perf_counter() - start
    (folder / "models").mkdir(exist_ok=True)
    export_onnx(found.bundle, _file(job, folder, "onnx"))
    parameters: dict[str, float] = {}
    if found.simulator is not None:
        save_simulator(found.simulator, _file(job, folder, "yaml"))
        chain = found.simulator.chain
        parameters = dict(zip(chain.labels, chain.values.tolist(), strict=True))
    scores = {}
    for record in case.tests:
        left = record.errors(over_record(job, folder, record))
        scores[record.name] = Score(float(np.sqrt(np.mean(left**2))), float(np.std(left)), record.span)
    return found.report, seconds, parameters, scores


def over_record(job: PublicJob, folder: Path, record: ScoredRecord) -> Vec:
    """Free run (T,) of the model in the folder over a test record; of a periodic one the steady state."""
    commands, readable = record.trial.command, _file(job, folder, "yaml")
    laps = np.tile(commands, _LAPS if record.periodic else 1)
    if readable.exists():
        run = ChainModel(load_simulator(readable)).run(laps, record.start)
    else:
        run = free_run(load_onnx(_file(job, folder, "onnx")), laps, record.start)
    return run[-commands.size :]


def _file(job: PublicJob, folder: Path, suffix: str) -> Path:
    return folder / "models" / f"{job.key}.{suffix}"

"""One kind of model on a public data set: identified from the training record, scored on the test."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping
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

from .boucwen import ScoredRecord, given_tests, read_record, simulated_tests
from .settings import PublicSettings

FORMAT = "hystmpc-public-job/1"
_LAPS = 3  # passes over a period: the first two end the transient


@dataclass(frozen=True)
class PublicJob:
    """One kind of model."""

    kind: str

    @property
    def key(self) -> str:
        """Name of its files."""
        return self.kind


@dataclass(frozen=True)
class PublicResult:
    """Outcome of one kind.

    Attributes:
        status: `failed` if anything raised.
        message: the error of a failed job, else how the identification went.
        fit_s: time of the identification [s].
        parameters: values of its readable form, with their labels; nothing of a network.
        rmse: of free runs by test record, in the unit of the data set.
    """

    job: PublicJob
    fingerprint: str
    status: Status
    message: str
    seconds: float
    fit_s: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    rmse: Mapping[str, float] = field(default_factory=dict)


def public_jobs(settings: PublicSettings) -> tuple[PublicJob, ...]:
    """A job for each kind."""
    return tuple(PublicJob(kind) for kind in dict.fromkeys(settings.kinds))


def fingerprint(job: PublicJob, settings: PublicSettings) -> str:
    """SHA-256 over the settings and the files."""
    files = [hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in (settings.data, *settings.test)]
    own = settings.model_dump(mode="json") | {"kinds": job.kind, "data": "", "test": files}
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()


def result_files(folder: Path) -> ResultFiles[PublicResult]:
    """Results of the study's folder."""
    return ResultFiles(folder, PublicResult, FORMAT)


def tests_of(settings: PublicSettings) -> list[ScoredRecord]:
    """The test records: those given, else those that are simulated here."""
    return given_tests(settings.test) or simulated_tests(settings.seed, settings.quick)


def study_kind(
    job: PublicJob, settings: PublicSettings, folder: Path
) -> tuple[str, float, dict[str, float], dict[str, float]]:
    """Identify and score; the model and its free runs are written into the folder.

    Returns:
        Message, time of the identification [s], parameters and errors, see `PublicResult`.

    Raises:
        HystmpcError: if a file cannot be used, or the kind cannot be identified from it.
    """
    kind, trial = kind_named(job.kind), read_record(settings.data)
    request = FitRequest(kind.usual_preset(False), settings.seed, settings.steps(job.kind))
    start = time.perf_counter()
    found = kind.fit([trial], request)
    seconds = time.perf_counter() - start
    (folder / "models").mkdir(exist_ok=True)
    export_onnx(found.bundle, _file(job, folder, "onnx"))
    parameters: dict[str, float] = {}
    if found.simulator is not None:
        save_simulator(found.simulator, _file(job, folder, "yaml"))
        chain = found.simulator.chain
        parameters = dict(zip(chain.labels, chain.values.tolist(), strict=True))
    errors = {}
    for record in tests_of(settings):
        predicted = over_record(job, folder, record)
        errors[record.name] = float(np.sqrt(np.mean((predicted - record.trial.angle) ** 2)))
    return found.report, seconds, parameters, errors


def over_record(job: PublicJob, folder: Path, record: ScoredRecord) -> Vec:
    """Free run (T,) of the model in the folder over a test record, from rest; of a periodic one the steady state."""
    commands, readable = record.trial.command, _file(job, folder, "yaml")
    laps = np.tile(commands, _LAPS if record.periodic else 1)
    if readable.exists():
        run = ChainModel(load_simulator(readable)).run(laps, 0.0)
    else:
        run = free_run(load_onnx(_file(job, folder, "onnx")), laps, 0.0)
    return run[-commands.size :]


def _file(job: PublicJob, folder: Path, suffix: str) -> Path:
    return folder / "models" / f"{job.kind}.{suffix}"

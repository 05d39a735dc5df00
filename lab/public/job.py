"""One kind of model on one case of a public data set: identified from its trials, scored on its test."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.evaluate import free_run
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.simulator import ChainModel, load_simulator, save_simulator
from hystmpc.trials.types import Vec

from .catalogue import data_set
from .records import ScoredRecord
from .settings import PublicJob, PublicSettings, Score

_LAPS = 3  # passes over a period: the first two end the transient


def run_kind(job: PublicJob, settings: PublicSettings, folder: Path) -> dict[str, Any]:
    """Message, time, parameters and scores of a job, see `PublicResult`; the model is written into the folder.

    Raises:
        HystmpcError: if a file cannot be used, or the kind cannot be identified from it.
    """
    kind = kind_named(job.kind)
    case = next(case for case in data_set(settings).cases(settings) if case.name == job.case)
    request = FitRequest(kind.usual_training(False), settings.seed, settings.steps(job.kind))
    start = time.perf_counter()
    identified = kind.fit(case.training, request)
    seconds = time.perf_counter() - start
    (folder / "models").mkdir(exist_ok=True)
    export_onnx(identified.bundle, _file(job, folder, "onnx"))
    parameters: dict[str, float] = {}
    if identified.simulator is not None:
        save_simulator(identified.simulator, _file(job, folder, "yaml"))
        chain = identified.simulator.chain
        parameters = dict(zip(chain.labels, chain.values.tolist(), strict=True))
    scores = {}
    for record in case.tests:
        left = record.errors(over_record(job, folder, record))
        scores[record.name] = Score(float(np.sqrt(np.mean(left**2))), float(np.std(left)), record.span)
    return {"message": identified.report, "fit_s": seconds, "parameters": parameters, "scores": scores}


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

"""Jobs of the closed-loop benchmark (models, gains, runs), what each depends on, and their results as files."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator

from hystmpc.sim.jobs.runner import ResultFiles, Status
from hystmpc.trials.errors import LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

from .controllers import CONTROLLERS, NETWORKS
from .models import backlash_file, companion_file, network_file
from .plants import PLANTS
from .settings import ControlSettings

FORMAT = "hystmpc-control-job/1"
SIGNALS = ("time_s", "reference_deg", "true_deg", "command")
FigureOrNull = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
Stage = Literal["fit", "tune", "retune", "run"]
STAGES: tuple[Stage, ...] = ("fit", "tune", "retune", "run")
"""In this order: every stage needs what the ones before it leave."""


@dataclass(frozen=True)
class ControlJob:
    """One job.

    Attributes:
        stage: `fit` identifies a model, `tune` searches gains at the first rate, `retune` at another, `run` is a
            controller along a motion.
        plant: by name; of a `fit` the family.
        rate_hz: of the loop; 0 for a `fit`.
        subject: kind of model of a `fit`, else controller.
        motion: of a `run`, else empty.
    """

    stage: Stage
    plant: str
    rate_hz: float
    subject: str
    motion: str = ""

    @property
    def key(self) -> str:
        """Name of the job's files: unique in a study."""
        parts = [self.stage, self.plant, f"{self.rate_hz:g}hz" if self.rate_hz else "", self.subject, self.motion]
        return "-".join(part for part in parts if part)


def control_jobs(settings: ControlSettings) -> tuple[ControlJob, ...]:
    """All jobs, stage by stage; controllers whose model does not hold at a rate are left out there."""
    runs = tuple(
        ControlJob("run", plant, rate, controller, motion)
        for plant in settings.plants
        for rate in settings.rates_hz
        for controller in settings.controllers
        if CONTROLLERS[controller].usable_at(rate)
        for motion in settings.motions
    )
    needs = ((PLANTS[job.plant].family, kind) for job in runs for kind in _models_for(job.subject))
    fits = [ControlJob("fit", family, 0.0, kind) for family, kind in dict.fromkeys(needs)]
    loops = dict.fromkeys((job.plant, job.rate_hz, job.subject) for job in runs if CONTROLLERS[job.subject].tuned)
    first = settings.rates_hz[0]
    tunes = [ControlJob("tune" if rate == first else "retune", plant, rate, name) for plant, rate, name in loops]
    order = {stage: k for k, stage in enumerate(STAGES)}
    return (*fits, *sorted(tunes, key=lambda job: order[job.stage]), *runs)


def _models_for(controller: str) -> tuple[str, ...]:
    model = CONTROLLERS[controller].model
    if model in NETWORKS:
        return ("backlash", model)
    return (model,) if model == "backlash" else ()


def fingerprint(job: ControlJob, settings: ControlSettings, folder: Path) -> str:
    """SHA-256 over what a job's result depends on: its settings, and the files that earlier stages left.

    A file that is not there yet counts as empty, so that the job will be found not to be done.
    """
    parts: dict[str, object] = {"job": asdict(job), "seed": settings.seed, "quick": settings.quick}
    if job.stage == "fit":
        parts |= {"updates": settings.network_updates, "rates": list(settings.rates_hz)}
        if job.subject in NETWORKS:
            del parts["rates"]
    else:
        parts["files"] = {file.name: _hash(file) for file in needed_files(job, settings, folder)}
    if job.stage in ("tune", "retune"):
        parts |= {"motions": list(settings.motions)}
        parts["evaluations"] = settings.tune_evaluations if job.stage == "tune" else settings.retune_evaluations
    parts["design"] = _design(job)
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def needed_files(job: ControlJob, settings: ControlSettings, folder: Path) -> tuple[Path, ...]:
    """Files of earlier stages that a job reads."""
    rival, plant = CONTROLLERS[job.subject], PLANTS[job.plant]
    files = [backlash_file(folder, plant, job.rate_hz)] if rival.model == "backlash" else []
    if rival.model in NETWORKS:
        files += [companion_file(folder, plant), network_file(folder, plant, rival.model)]
    if rival.tuned and job.stage == "run":
        files.append(gains_file(folder, job.plant, job.rate_hz, job.subject))
    if job.stage == "retune":
        files.append(gains_file(folder, job.plant, settings.rates_hz[0], job.subject))
    return tuple(files)


def gains_file(folder: Path, plant: str, rate_hz: float, controller: str) -> Path:
    """File of the gains that a search has found."""
    return folder / "models" / f"{plant}-{controller}-{rate_hz:g}hz.json"


def _hash(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.exists() else ""


def _design(job: ControlJob) -> dict[str, object]:
    """The plant and the controller's settings as they stand in the code: a changed benchmark is run anew."""
    plant = PLANTS[job.plant]
    facts: dict[str, object] = {"plant": repr(plant)}
    if job.stage != "fit":
        facts["controller"] = CONTROLLERS[job.subject].settings(1 / job.rate_hz, 0)
    return facts


@dataclass(frozen=True)
class ControlResult:
    """Outcome of one job.

    Attributes:
        status: `failed` if anything raised.
        message: the error of a failed job, else one line on how it went.
        figures: of a run, see `control_figures`; of a search its error; NaN where there is none.
        ladder: of a run, samples by source of the command.
    """

    job: ControlJob
    fingerprint: str
    status: Status
    message: str
    seconds: float
    figures: Mapping[str, FigureOrNull] = field(default_factory=dict)
    ladder: Mapping[str, int] = field(default_factory=dict)


def result_files(folder: Path) -> ResultFiles[ControlResult]:
    """Results of the benchmark's folder; a figure that is not there is null."""
    return ResultFiles(folder, ControlResult, FORMAT, _plain)


def _plain(result: ControlResult) -> dict[str, Any]:
    return asdict(result) | {"figures": {k: v if math.isfinite(v) else None for k, v in result.figures.items()}}


def signals_file(folder: Path, job: ControlJob) -> Path:
    """File of a run's signals."""
    return folder / "runs" / f"{job.key}.npz"


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

"""Jobs of the closed-loop benchmark (models, gains, runs), what each depends on, and the signals of a run as a file."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from hystmpc.trials.errors import LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

from .controllers import CONTROLLERS, NETWORKS
from .models import backlash_file, companion_file, network_file
from .plants import PLANTS
from .settings import STAGES, ControlJob, ControlSettings

SIGNALS = ("time_s", "reference_deg", "true_deg", "command")


def control_jobs(settings: ControlSettings, drawn: object = None) -> tuple[ControlJob, ...]:
    """All jobs, stage by stage; controllers whose model does not hold at a rate are left out there."""
    del drawn  # the plants are always the same
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


def job_inputs(job: ControlJob, settings: ControlSettings, folder: Path) -> dict[str, object]:
    """What a job's result depends on: its settings, and the files that earlier stages left.

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
    return parts


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

"""Jobs of the closed-loop benchmark: their files and inputs, and each job as a closed-loop study."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from hystmpc.ctrl.feedback import InversePidControllerSettings, PidControllerSettings, PidSettings
from hystmpc.ctrl.loop import Controller
from hystmpc.models.model import Predictor
from hystmpc.models.motions import initialisation_flexure
from hystmpc.models.simulator import save_simulator
from hystmpc.sim.config import SimulationConfig, TuningSettings
from hystmpc.sim.plants.computed import ComputedPlant
from hystmpc.sim.plants.simulated import Effects
from hystmpc.sim.study import Study, prepare, run_closed_loop
from hystmpc.sim.tuning.gains import tuned_gains
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

from ..devices.exact import Rehearsed
from .bars import control_figures
from .plants import PLANTS, Plant, backlash_file, companion_file, half_width, network_file
from .settings import CONTROLLERS, NETWORKS, STAGES, BenchmarkController, ControlJob, ControlSettings, motion

SIGNALS = ("time_s", "reference_deg", "true_deg", "command")


def control_jobs(settings: ControlSettings, drawn: object = None) -> tuple[ControlJob, ...]:
    """All jobs by stage, without controllers whose model is invalid at a rate."""
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
    """Inputs of a job's result: its settings, and the files of earlier stages.

    A missing file counts as empty, so that the job counts as not done.
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
    """File of the gains found by a search."""
    return folder / "models" / f"{plant}-{controller}-{rate_hz:g}hz.json"


def _hash(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.exists() else ""


def _design(job: ControlJob) -> dict[str, object]:
    """Plant and controller settings as defined in the code, so that a changed benchmark is run again."""
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
    """Read the signals (N,) of a run.

    Raises:
        LogError: if they are gone or damaged.
    """
    path = signals_file(folder, job)
    try:
        with np.load(path) as stored:
            return {name: stored[name].astype(np.float64) for name in SIGNALS}
    except (OSError, ValueError, KeyError) as error:
        raise LogError(f"{path}: no signals of a run ({error}); remove its result to have it done again") from None


_WHOLE = 1e-9
_REHEARSAL = 1000
_SETTLED_LAGS = 20.0  # after the flexure, as `SimulatedPlant` waits


@final
class RestedPredictor(Predictor):
    """Predictor whose initial state is that after given commands, instead of that by a rule.

    The rule of a model puts all plays where they show the measured angle; their true states are determined only by
    the earlier commands.

    Args:
        before: commands (T,) before the first sample, the last of them at rest.
    """

    def __init__(self, predictor: Predictor, before: Vec) -> None:
        self.dt, self.command_range, self.noise = predictor.dt, predictor.command_range, predictor.noise
        self._predictor, self._before = predictor, before

    def initial(self, y: float, u: float) -> Vec:
        state = self._predictor.initial(y, u)
        for command in self._before:
            _, state = self._predictor.advance(state, float(command))
        return state

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        return self._predictor.advance(state, u)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._predictor.rollout(state, plans)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        return self._predictor.linearise(state, plan)


def watched_flexure(plant: ComputedPlant, seed: int) -> tuple[Vec, Vec]:
    """Commands of one initialisation flexure and its rest, and the angle measured at each of them.

    The device is flexed from the rest after `reset`, and returns to it, which erases its earlier memory.

    Args:
        plant: the device; its state is unchanged afterwards.
        seed: of the sensor noise, which must not be that of the run.
    """
    device = plant.reseeded(seed)
    commands = initialisation_flexure(device.command_limits, device.dt, warmup_samples=1)
    angles = [device.reset()]
    angles += [device.apply(float(u)) for u in commands]
    return commands, np.array(angles[:-1])


def run_along(
    job: ControlJob, settings: ControlSettings, folder: Path
) -> tuple[Mapping[str, float], Mapping[str, int]]:
    """Figures of a controller along a motion, and its samples by source; the signals are written."""
    study = study_of(job, settings, folder, (job.motion,))
    controller = _ready(study, job, settings.seed)
    run = run_closed_loop(controller, study.plant, study.motions[job.motion])
    if run.log.interrupted:
        raise KeyboardInterrupt
    log = run.log
    signals = {"time_s": log.time_s, "reference_deg": log.reference_deg, "true_deg": run.true_deg}
    save_signals(folder, job, signals | {"command": log.command})
    width = half_width(PLANTS[job.plant].simulator(1 / job.rate_hz))
    delay = math.ceil(PLANTS[job.plant].effects.delay_s * job.rate_hz - _WHOLE)
    figures = control_figures(run, study.limits, width, controller.horizon, delay)
    counts = {str(source): log.source.count(source) for source in dict.fromkeys(log.source)}
    return figures, counts


def _ready(study: Study, job: ControlJob, seed: int) -> Controller[Any]:
    """Controller of the job; a learning one has observed the flexure, with a different noise realisation."""
    controller = study.controller(study.config.controllers[job.subject])
    if not CONTROLLERS[job.subject].learns:
        return controller
    return Rehearsed(controller, *watched_flexure(study.plant, seed + _REHEARSAL))


def tune(job: ControlJob, settings: ControlSettings, folder: Path) -> tuple[str, Mapping[str, float]]:
    """Search a PID's gains over all motions of the study and write them.

    Raises:
        ConfigError: if the controller has no PID.
    """
    study = study_of(job, settings, folder, settings.motions)
    evaluations = settings.tune_evaluations if job.stage == "tune" else settings.retune_evaluations
    study = replace(study, config=study.config.model_copy(update={"tune_pid": TuningSettings(evaluations=evaluations)}))
    chosen = study.config.controllers[job.subject]
    if not isinstance(chosen, PidControllerSettings | InversePidControllerSettings):
        raise ConfigError(f"{job.key}: got a controller of kind {chosen.kind}, expected one with a PID")
    tuned = tuned_gains(study, chosen)
    gains = tuned.settings.gains.model_dump()
    write_atomically(gains_file(folder, job.plant, job.rate_hz, job.subject), json.dumps(gains, indent=1) + "\n")
    line = ", ".join(f"{name} {value:.4g}" for name, value in gains.items())
    return f"{line}; {tuned.evaluations} evaluations", {"rmse_deg": tuned.rmse_deg, "start_deg": tuned.start_rmse_deg}


def study_of(job: ControlJob, settings: ControlSettings, folder: Path, motions: tuple[str, ...]) -> Study:
    """Closed-loop study of the job's plant with its model, some motions and its controller."""
    plant, rival, dt_s = PLANTS[job.plant], CONTROLLERS[job.subject], 1 / job.rate_hz
    rest = plant.device(dt_s).true_angle
    nominal = plant.nominal()
    simulator = save_simulator(plant.simulator(dt_s), folder / "models" / f"{plant.name}-plant-{job.rate_hz:g}hz.yaml")
    data: dict[str, Any] = {
        "plant": {"simulator": str(simulator)} | _effects(plant),
        "motions": {name: motion(name, rest, settings.seed, settings.quick) for name in motions},
        "seed": settings.seed,
    }
    delay = round(nominal.effects.delay_s / dt_s)
    data |= {"model": str(simulator)}
    if rival.oracle:
        known, delay = plant.oracle(dt_s)
        data["model"] = str(save_simulator(known, folder / "models" / f"{plant.name}-oracle-{job.rate_hz:g}hz.yaml"))
    elif rival.model in NETWORKS:
        data |= {"model": str(network_file(folder, plant, rival.model)), "inverse": str(companion_file(folder, plant))}
    elif rival.model == "backlash":
        data |= {"model": str(backlash_file(folder, plant, job.rate_hz)), "actuator_lag_s": nominal.effects.lag_s}
    controller = rival.settings(dt_s, delay) | _gains(job, rival, settings, folder)
    study = prepare(SimulationConfig.parse(data | {"controllers": {job.subject: controller}}, job.key))
    return _rested(study, plant.effects, dt_s) if rival.oracle else study


def _effects(plant: Plant) -> dict[str, float]:
    effects = plant.effects
    return {"lag_s": effects.lag_s, "delay_s": effects.delay_s, "noise_deg": effects.noise_deg}


def _gains(job: ControlJob, rival: BenchmarkController, settings: ControlSettings, folder: Path) -> dict[str, Any]:
    """Gains of a search at this rate, or at the first rate as the start of another search."""
    if not rival.tuned or job.stage == "tune":
        return {}
    rate = settings.rates_hz[0] if job.stage == "retune" else job.rate_hz
    file = gains_file(folder, job.plant, rate, job.subject)
    try:
        return {"gains": PidSettings.parse(json.loads(file.read_text(encoding="utf-8")), str(file)).model_dump()}
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: no gains ({error}), expected those that the search writes") from None


def _rested(study: Study, effects: Effects, dt_s: float) -> Study:
    """Study with an oracle that has the plant's memory after its initialisation flexure."""
    (known, inverse), limits = study.model.predictive, study.plant.command_limits
    flexure = initialisation_flexure(limits, dt_s, warmup_samples=1)
    wait_s = _SETTLED_LAGS * effects.lag_s + effects.delay_s
    settling = np.full(round(wait_s / dt_s), limits.lower)
    rested = RestedPredictor(known, np.concatenate([flexure, settling]))
    return replace(study, model=replace(study.model, predictive=(rested, inverse)))

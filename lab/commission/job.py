"""Jobs of the commissioning study: a device is commissioned, then controlled with other models or sensors."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, final

import numpy as np

from hystmpc.bench.commission import Commissioned, commission_device
from hystmpc.bench.config import CommissionSettings
from hystmpc.bench.device import BenchDevice
from hystmpc.bench.identify import TIP_FILE, tip_settings
from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import limits_of_model
from hystmpc.ctrl.feedback import InverseControllerSettings, PidControllerSettings
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.law import LawSettings
from hystmpc.ctrl.loop import Controller, ImagingSettings, NoSensorSettings, Plant
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.gap.diagnose import diagnose_trials
from hystmpc.gap.expected_tracking import DEFAULT_CONTROLLER, covered_motions
from hystmpc.models.contract.metadata import Range
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.prediction.build import ControllerModel, controller_model
from hystmpc.models.simulator import ChainModel, load_simulator
from hystmpc.rig.transports.simulated import SimulatedSettings
from hystmpc.rig.transports.transport import PlantFactory
from hystmpc.sim.plants.computed import ComputedPlant, Sensing
from hystmpc.sim.study import ClosedLoopRun
from hystmpc.sim.tuning.gains import searched_gains
from hystmpc.trajectories.drawn import CountedMotion
from hystmpc.trials.types import Vec

from ..devices.drawn import DrawnDevice, DrawnPlant, drawn_devices, worn
from ..devices.exact import Rehearsed
from ..devices.motions import fresh_motions, recordings
from ..identify.job import (
    AS_IDENTIFIED_NOISE_DEG,
    DeviceStudy,
    IdentifiedPlant,
    controller_on,
    identified_as,
    opened_model,
    tracked,
    tuned_rivals,
)
from ..identify.settings import IdentifySettings
from .settings import WORN, CommissionJob, CommissionStudySettings

_SLOW_S, _QUICK_S, _TOP_S, _REST_S = 4.0, 1.2, 0.3, 0.5  # of a stroke of either flexure, at its top, and behind it
_MARGIN = 0.3  # of the reachable angles: how much more than them the sensor shows at either end
_SENSOR_DEG_S = 5000.0  # an air muscle jumps by 25 deg in a sample of 25 Hz
_SLACK = 0.8  # of the travel: a slack tendon moves nothing before
_RAMP = 0.3  # share of the greatest rate at which the bench moves by itself


@final
class PreparedPlant(ComputedPlant):
    """Random device at rest after a slow and a quick flexure, as after the preparation of a bench.

    Attributes:
        commands, angles_deg: what was sent, and the angle measured when it was (T,).
    """

    def __init__(self, plant: DrawnPlant, seed: int) -> None:
        self._plant, device = plant, plant.device
        self.command_limits = Range(lower=device.limits.lower, upper=device.limits.upper)
        asked = np.concatenate([_flexure(device, _SLOW_S), _flexure(device, _QUICK_S)])
        self.commands = device.limits.clip_plans(asked, plant.rest_command, plant.dt)
        flexed = plant.reseeded(seed)
        angle, angles = flexed.reset(), []
        for u in self.commands.tolist():
            angles.append(angle)
            angle = flexed.apply(u)
        self.angles_deg: Vec = np.array(angles)
        self._prepared = flexed.true_angle, flexed._state
        super().__init__(plant.dt, plant.rest_command, plant.command_unit, Sensing(device.noise_deg), seed)

    def _at_rest(self, random: np.random.Generator) -> tuple[float, Any]:
        del random
        return self._prepared

    def _advanced(self, state: Vec, u: float, random: np.random.Generator) -> tuple[float, Vec]:
        return self._plant._advanced(state, u, random)


def _flexure(device: DrawnDevice, stroke_s: float) -> Vec:
    """Commands over the whole travel and back, with a rest at the top and at the end."""
    up = np.linspace(0.0, device.limits.upper, round(stroke_s * device.rate_hz) + 1)[1:]
    top = np.full(round(_TOP_S * device.rate_hz), device.limits.upper)
    rest = np.zeros(round(_REST_S * device.rate_hz))
    return np.concatenate([up, top, up[-2::-1], [0.0], rest])


@final
class TakenUp(Rehearsed):
    """Controller that replays the preparation of a `PreparedPlant` at its start, as `hystmpc run` does.

    Args:
        sensor: an imaging system that has seen the preparation in frames; the angle in every sample where left out.
    """

    def __init__(
        self, controller: GuardedController, plant: PreparedPlant, sensor: ImagingSettings | None = None
    ) -> None:
        angles = plant.angles_deg
        if sensor is not None:
            every = max(round(1.0 / (sensor.rate_hz * plant.dt)), 1)
            noise = np.random.default_rng(plant.seed).standard_normal(angles.size)
            seen = np.arange(angles.size) % every == 0
            angles = np.where(seen, angles + sensor.noise_deg * noise, np.nan)
        super().__init__(controller, plant.commands, angles)

    def init(self, y: float, u: float) -> GuardedState:
        del y, u
        return self._controller.replay(self._commands, self._angles)


def bench_settings(plant: DrawnPlant, commission: Mapping[str, Any], folder: Path) -> CommissionSettings:
    """Bench of a random device with the block `commission`, as a user would write it into the file."""
    device, limits = plant.device, plant.device.limits
    low, high = plant.reachable_deg
    margin = _MARGIN * (high - low)
    ramps = {
        "velocity_per_s": _RAMP * limits.rate,
        "acceleration_per_s2": 5 * limits.rate,
        "jerk_per_s3": 50 * limits.rate,
    }
    return CommissionSettings.parse(
        {
            "name": device.key,
            "rate_hz": device.rate_hz,
            "command_unit": device.unit,
            "limits": {"lower": limits.lower, "upper": limits.upper, "rate_per_s": limits.rate},
            "ramps": ramps,
            "safe_command": limits.lower,
            "sensor": {
                "lower_deg": min(low, plant.true_angle) - margin,
                "upper_deg": high + margin,
                "rate_limit_deg_s": _SENSOR_DEG_S,
            },
            "plausibility": {"travel": _SLACK * limits.upper},
            "transport": {"kind": "simulated", "plant": {"device": device.key}, "seed": device.seed % 1000},
            "prepare": [{"step": "flexure", "lower": limits.lower, "upper": limits.upper}],
            "latch_file": str(folder / "latch.json"),
            "commission": {**commission, "seed": device.seed % 1000},
        },
        device.key,
    )


def drawn_plants(device: DrawnDevice) -> PlantFactory:
    """Factory of the device behind its bench; the seed of the transport is that of the noise."""

    def made(settings: SimulatedSettings, dt_s: float) -> tuple[Plant, float]:
        del dt_s
        plant = DrawnPlant(device, settings.seed)
        return plant, plant.rest_command

    return made


IMAGING = ImagingSettings(rate_hz=5.0, latency_s=0.2, noise_deg=0.5)
UNKNOWN_LAG_S = 0.2
BAND_SIGMAS = 1.645
"""Half of a band that holds 90 % of a normal distribution, in standard deviations."""

_ANY_REST_DEG = 360.0  # the model of another device rests at another angle
_QUICK = {"minutes": 4.0, "tune_evaluations": 24}  # of the block `commission`
_COMPARED, _DIAGNOSED = 1, 5  # seeds of the noise, beside the device's
_IMAGING_SHARE = 5  # the search under frames costs more: a share of the evaluations


def run_stage(job: CommissionJob, settings: CommissionStudySettings, folder: Path) -> dict[str, Any]:
    """Execute a job; return its message and figures."""
    bench = StudyBench(settings, folder, drawn_devices(settings)[job.number])
    message, figures = {"commission": _commission, "compare": _compare, "gap": _tracking_gap}[job.stage](bench)
    return {"message": message, "figures": figures}


@dataclass(frozen=True, eq=False)
class StudyBench:
    """Device of the study, its motions, and its commissioned controllers."""

    settings: CommissionStudySettings
    folder: Path
    device: DrawnDevice

    @cached_property
    def drawn(self) -> DrawnPlant:
        """Device with the noise of the comparison."""
        return DrawnPlant(self.device, self.device.seed + _COMPARED)

    @cached_property
    def plant(self) -> PreparedPlant:
        """Device at rest after the preparation."""
        return PreparedPlant(self.drawn, self.device.seed + _COMPARED)

    @cached_property
    def motions(self) -> tuple[CountedMotion, ...]:
        """New references within the angles that the device reaches."""
        return fresh_motions(self.drawn, self.settings.quick)

    def tip(self, device: DrawnDevice | None = None) -> Path:
        """Controller file of a commissioned device of this study, by default of this one."""
        return self.folder / "commissioned" / (device or self.device).key / TIP_FILE

    def along(
        self,
        name: str,
        controller: Controller[Any],
        plant: ComputedPlant | None = None,
        motions: tuple[CountedMotion, ...] | None = None,
        sensor: ImagingSettings | NoSensorSettings | None = None,
    ) -> tuple[dict[str, float], list[ClosedLoopRun]]:
        """Figures of a controller over all motions, with prefix `name`, and the runs."""
        return tracked(name, controller, plant or self.plant, motions or self.motions, self.device, sensor=sensor)


def _commission(bench: StudyBench) -> tuple[str, dict[str, float]]:
    """Commission the device; compare its controller with rivals tuned on the same device and motions."""
    start, device, settings = time.process_time(), bench.device, bench.settings
    folder = bench.tip().parent
    block = {"minutes": settings.minutes, "diagnose": settings.diagnose} | (_QUICK if settings.quick else {})
    config = bench_settings(bench.drawn, block, folder)
    plants = drawn_plants(device)
    commissioned = commission_device(
        config, lambda root, tick: BenchDevice(config, plants, root, None, tick=tick), folder
    )
    figures = _verified(commissioned) | {"seconds.commission": time.process_time() - start}
    trials = recordings(DrawnPlant(device, device.seed), settings.quick)
    rival = opened_model(identified_as(kind_named("pi"), trials, device, settings.seed), folder / "rival")
    known, tip = _known(bench.tip())
    identify = IdentifySettings.of(devices=settings.devices, evaluations=settings.evaluations, seed=settings.seed)
    study = DeviceStudy(device, bench.drawn, bench.motions, known, rival)
    for name, controller in tuned_rivals(study, identify).items():
        figures |= bench.along(name, controller)[0]
    cases: dict[str, dict[str, Any]] = {"commissioned": {}, "learning_off": {"adaptation": None}}
    for name, changed in cases.items():
        controller = controller_on(_of(tip, changed), known, device.limits)
        figures |= bench.along(name, TakenUp(controller, bench.plant))[0]
    return commissioned.verified.verdict if commissioned.verified else "", figures


def _verified(commissioned: Commissioned) -> dict[str, float]:
    figures = {"device_s": commissioned.device_s}
    if commissioned.verified is not None:
        figures["verified"] = float(commissioned.verified.verified)
        figures |= {f"verify.{name}.rms_deg": score.rms_deg for name, score in commissioned.verified.scores.items()}
    return figures


def _compare(bench: StudyBench) -> tuple[str, dict[str, float]]:
    """Comparison with models of other devices, on a changed device, and with other sensors."""
    device, settings = bench.device, bench.settings
    identified, tip = _known(bench.tip())
    drawn = drawn_devices(settings)
    anywhere = {"estimator": {"rest_tolerance_deg": _ANY_REST_DEG}}
    figures: dict[str, float] = {}
    others: dict[str, Callable[[DrawnDevice], bool]] = {
        "sibling": lambda d: d.family == device.family,
        "stranger": lambda d: d.family != device.family,
    }
    for name, fits in others.items():
        other = _next(drawn, device, fits)
        if other is None:
            continue
        known, _ = _known(bench.tip(other))
        cases: dict[str, dict[str, Any]] = {name: anywhere, f"{name}_off": anywhere | {"adaptation": None}}
        for case, changed in cases.items():
            controller = controller_on(_of(LinearisedMpcSettings(), changed), known, device.limits)
            figures |= bench.along(case, TakenUp(controller, bench.plant))[0]
    lagging = controller_model(str(_model(bench.tip())), None, UNKNOWN_LAG_S)
    figures |= bench.along("wrong_lag", TakenUp(controller_on(tip, lagging, device.limits), bench.plant))[0]
    for name, factors in WORN.items():
        figures |= _changed(bench, name, factors, identified, tip)
    figures |= _sensors(bench, identified, tip)
    return "", figures


def _changed(
    bench: StudyBench, name: str, factors: tuple[float, float], identified: ControllerModel, tip: LawSettings
) -> dict[str, float]:
    """Controller on the changed device, with and without learning; motions within its new range."""
    device, seed = worn(bench.device, *factors), bench.device.seed + _COMPARED
    drawn = DrawnPlant(device, seed)
    plant, motions = PreparedPlant(drawn, seed), fresh_motions(drawn, bench.settings.quick)
    figures: dict[str, float] = {}
    anywhere = {"estimator": {"rest_tolerance_deg": _ANY_REST_DEG}}
    cases: dict[str, dict[str, Any]] = {name: anywhere, f"{name}_off": anywhere | {"adaptation": None}}
    for case, changed in cases.items():
        controller = TakenUp(controller_on(_of(tip, changed), identified, device.limits), plant)
        figures |= bench.along(case, controller, plant, motions)[0]
    return figures


def _sensors(bench: StudyBench, identified: ControllerModel, tip: LawSettings) -> dict[str, float]:
    """Figures without a sensor, with frames of an imaging system, and of the PID tuned for frames."""
    limits, blind, frames = bench.device.limits, NoSensorSettings(), IMAGING
    alone = _of(tip, {"estimator": dict(blind.estimator_keys())})
    figures, runs = bench.along("none", TakenUp(controller_on(alone, identified, limits), bench.plant), sensor=blind)
    noise = identified.predictive[0].noise
    sigma = math.nan if noise is None or noise.model_sigma_deg is None else noise.model_sigma_deg
    inside = [
        np.abs(run.true_deg - run.log.predicted_deg)[motion.first(run.dt) :] <= BAND_SIGMAS * sigma
        for run, motion in zip(runs, bench.motions, strict=True)
    ]
    figures |= {"none.sigma_deg": sigma, "none.within_band": float(np.mean(np.concatenate(inside)))}
    seeing = _of(tip, {"estimator": dict(frames.estimator_keys())})
    figures |= bench.along(
        "imaging", TakenUp(controller_on(seeing, identified, limits), bench.plant, frames), sensor=frames
    )[0]
    figures |= bench.along("imaging_pid", _imaging_pid(bench, identified), sensor=frames)[0]
    model = IdentifiedPlant(identified, bench.drawn.true_angle, AS_IDENTIFIED_NOISE_DEG, bench.device.seed)
    rivals: dict[str, LawSettings] = {
        "as_identified_none": alone,
        "as_identified_inverse": InverseControllerSettings(),
    }
    for name, settings in rivals.items():
        sensor = blind if name.endswith("none") else None
        figures |= bench.along(name, controller_on(settings, identified, limits), model, sensor=sensor)[0]
    return figures


def _imaging_pid(bench: StudyBench, identified: ControllerModel) -> Controller[Any]:
    """PID tuned on the same device and motions under other frames."""
    start = PidControllerSettings.parse({"kind": "pid", "estimator": _known_to_pid(IMAGING)})
    plant = PreparedPlant(bench.drawn, bench.device.seed + _COMPARED + 1)

    def mean_square(tried: LawSettings) -> float:
        _, runs = bench.along("", controller_on(tried, identified, bench.device.limits), plant, sensor=IMAGING)
        errors = [run.error_deg[motion.first(run.dt) :] for run, motion in zip(runs, bench.motions, strict=True)]
        return float(np.mean([np.mean(error**2) for error in errors]))

    evaluations = max(bench.settings.evaluations // _IMAGING_SHARE, 10)
    best = searched_gains(start, mean_square, evaluations, bench.settings.seed)
    return controller_on(best.settings, identified, bench.device.limits)


def _known_to_pid(sensor: ImagingSettings) -> dict[str, Any]:
    keys = type(PidControllerSettings().estimator).model_fields
    return {key: value for key, value in sensor.estimator_keys().items() if key in keys}


def _tracking_gap(bench: StudyBench) -> tuple[str, dict[str, float]]:
    """Diagnosis of a Prandtl-Ishlinskii model: predicted and real reduction of the tracking error."""
    device = bench.device
    trials = recordings(DrawnPlant(device, device.seed + _DIAGNOSED), bench.settings.quick)
    nominal = load_simulator(bench.tip().parent / "rival.yaml")
    data = diagnose_trials(trials, nominal, seed=bench.settings.seed).data
    said, fixed = data.diagnosis.tracking, data.fixed
    if said is None or said.why_not or fixed is None:
        return f"not said: {said.why_not if said else ''}", {"gap.said": 0.0}
    motions = covered_motions(data.trials, fixed, data.seed)
    figures = {"gap.said": 1.0, "gap.said_before_deg": said.before_deg, "gap.said_after_deg": said.after_deg}
    figures["gap.floor_deg"] = data.diagnosis.gap.floor_rmse_deg
    for name, simulator in (("before", nominal), ("after", fixed)):
        known = controller_model(ChainModel(simulator, "conditioned"))
        controller = build_controller(DEFAULT_CONTROLLER, *known.predictive, limits_of_model(nominal.metadata()))
        scored, _ = bench.along(name, controller, bench.drawn, motions)
        figures[f"gap.{name}_deg"] = scored[f"{name}.rmse_deg"]
    return "", figures


def _next(
    drawn: tuple[DrawnDevice, ...], device: DrawnDevice, fits: Callable[[DrawnDevice], bool]
) -> DrawnDevice | None:
    """Next suitable device of the draw with the same rate; None without one."""
    for step in range(1, len(drawn)):
        other = drawn[(device.number + step) % len(drawn)]
        if other.rate_hz == device.rate_hz and fits(other):
            return other
    return None


def _model(tip: Path) -> Path:
    return Path(tip_settings(tip).model)


def _known(tip: Path) -> tuple[ControllerModel, LawSettings]:
    return controller_model(str(_model(tip))), tip_settings(tip).controller.resolved()


def _of(settings: LawSettings, changes: Mapping[str, Any]) -> LawSettings:
    """Controller with some keys changed, blocks merged; without learning there is no supervisor."""
    data = settings.model_dump(exclude_unset=True) | {"kind": type(settings).model_fields["kind"].default}
    for key, value in changes.items():
        data[key] = data.get(key, {}) | value if isinstance(value, dict) else value
    if data.get("adaptation", {}) is None:
        data.pop("supervisor", None)
    return type(settings).parse(data, "study commission")

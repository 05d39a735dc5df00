"""One drawn device from its logs to its figures: identified, controlled as identified, beside rivals tuned on it."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.feedback.inverse_settings import InverseControllerSettings, InversePidControllerSettings
from hystmpc.ctrl.feedback.pid import PidControllerSettings, PidSettings
from hystmpc.ctrl.law import LawSettings
from hystmpc.ctrl.limits import CommandLimits
from hystmpc.ctrl.loop import Controller
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, SamplingMpcSettings
from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.kinds.catalogue import chosen_kind, kind_named
from hystmpc.models.kinds.kind import FitRequest, Identified, ModelKind
from hystmpc.models.simulator import save_simulator
from hystmpc.sim.closed_loop import ClosedLoopRun, run_closed_loop
from hystmpc.sim.jobs.runner import ResultFiles, Status
from hystmpc.sim.plants.computed import ComputedPlant
from hystmpc.sim.study import Knowledge, knowledge
from hystmpc.sim.tune_pid import PidLike, searched_gains
from hystmpc.trajectories.drawn import CountedMotion
from hystmpc.trials.trial import Trial

from . import kernels
from .device import DrawnDevice, DrawnPlant, draw_devices
from .exact import exact_controller
from .kernels import PidNumbers
from .motions import fresh_motions, recordings
from .scores import AS_IDENTIFIED_NOISE_DEG, IdentifiedPlant, scores
from .settings import IdentifySettings

FORMAT = "hystmpc-identify-job/1"
FigureOrNull = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
Interval = tuple[FigureOrNull, FigureOrNull, FigureOrNull]
_RIVAL_MODEL = "pi"
_TUNING, _COMPARED = 1001, 1  # seeds of the noise, beside the device's


@dataclass(frozen=True)
class IdentifyJob:
    """One device of the draw."""

    number: int
    key: str


@dataclass(frozen=True)
class IdentifyResult:
    """Outcome of one device.

    Attributes:
        status: `failed` if anything raised.
        message: the error of a failed job, else how the identification went.
        truth: what was drawn, 0 for what is not there: lag [s], delay [s], creep [1].
        found: value and 90 % interval of what was found, by the same names; what is not among them is not there.
        facts: of the device: family, rate, noise and further numbers, for tables.
        figures: see `scores.scores`, by controller and figure such as `linearised.rmse_deg`; seconds by stage.
    """

    job: IdentifyJob
    fingerprint: str
    status: Status
    message: str
    seconds: float
    truth: Mapping[str, float] = field(default_factory=dict)
    found: Mapping[str, Interval] = field(default_factory=dict)
    facts: Mapping[str, str | float] = field(default_factory=dict)
    figures: Mapping[str, FigureOrNull] = field(default_factory=dict)


def identify_jobs(settings: IdentifySettings) -> tuple[IdentifyJob, ...]:
    """A job for each device."""
    drawn = draw_devices(settings.devices, settings.seed, settings.quick)
    rates = settings.rates_hz
    return tuple(IdentifyJob(d.number, d.key) for d in drawn if not rates or d.rate_hz in rates)


def fingerprint(job: IdentifyJob, settings: IdentifySettings) -> str:
    """SHA-256 over the device's numbers and the settings."""
    device = draw_devices(settings.devices, settings.seed, settings.quick)[job.number]
    parts = {"device": repr(device), "settings": settings.model_dump(mode="json")}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def result_files(folder: Path) -> ResultFiles[IdentifyResult]:
    """Results of the study's folder; a figure that is not there is null."""
    return ResultFiles(folder, IdentifyResult, FORMAT, plain)


def plain(result: IdentifyResult) -> dict[str, Any]:
    """A result as JSON; a figure that is not there is null."""

    def finite(value: float) -> float | None:
        return value if math.isfinite(value) else None

    found = {name: [finite(v) for v in interval] for name, interval in result.found.items()}
    return asdict(result) | {"found": found, "figures": {k: finite(v) for k, v in result.figures.items()}}


@dataclass(frozen=True, eq=False)
class DeviceStudy:
    """What is known of one device when its controllers are built.

    Attributes:
        model, rival: the identified model, and the Prandtl-Ishlinskii model that the inverse of the rivals is of.
    """

    device: DrawnDevice
    plant: DrawnPlant
    motions: tuple[CountedMotion, ...]
    model: Knowledge
    rival: Knowledge


@dataclass
class _Watch:
    """Processor time by stage [s]."""

    seconds: dict[str, float]
    last: float

    def lap(self, name: str) -> None:
        now = time.process_time()
        self.seconds[f"seconds.{name}"], self.last = now - self.last, now


def study_device(
    job: IdentifyJob, settings: IdentifySettings, folder: Path
) -> tuple[str, dict[str, Interval], dict[str, float]]:
    """How the identification went, what it found, and the figures of all controllers; models are written.

    Raises:
        FitError: if a model cannot be identified.
        HystmpcError: if a controller cannot be built.
    """
    device = draw_devices(settings.devices, settings.seed, settings.quick)[job.number]
    watch = _Watch({}, time.process_time())
    plant = DrawnPlant(device, device.seed)
    trials = recordings(plant, settings.quick)
    watch.lap("record")
    identified = identified_as(chosen_kind(settings.kind, settings.drive), trials, device, settings.seed)
    model = opened_model(identified, folder / "models" / f"{device.key}-{settings.kind}")
    watch.lap("identify")
    rivals = identified_as(kind_named(_RIVAL_MODEL), trials, device, settings.seed)
    rival = opened_model(rivals, folder / "models" / f"{device.key}-rival")
    watch.lap("rival")
    plant = plant.reseeded(device.seed + _COMPARED)
    study = DeviceStudy(device, plant, fresh_motions(plant, settings.quick), model, rival)
    controllers = _model_controllers(study) | tuned_rivals(study, settings)
    watch.lap("tune")
    figures: dict[str, float] = {}
    for name, controller in controllers.items():
        figures |= _along(name, controller, plant, study, device.delay_s)
        watch.lap(name)
    figures |= _as_identified(study)
    watch.lap("as_identified")
    return identified.report, found_parts(identified), figures | watch.seconds


def found_parts(identified: Identified) -> dict[str, Interval]:
    """What an identification says of the parts around the hysteresis: value and ends of its 90 % interval, by name.

    Names are those of `DrawnDevice.truth`; a part that it did not find is left out.
    """
    found: dict[str, Interval] = {}
    for row in identified.parts.parameters if identified.parts else ():
        low, high = row.ci90
        if (row.owner, row.name) in (("lag", "tau_s"), ("delay", "delay_s")):
            found[row.owner] = (row.value, low, high)
        elif row.owner == "creep" and row.name.startswith("share"):
            before = found.get("creep", (0.0, 0.0, 0.0))  # of two terms the sum; drawn shares have the other sign
            found["creep"] = (before[0] - row.value, before[1] - high, before[2] - low)
        elif row.owner == "lag" and row.name in ("tau_up_s", "top_speed"):
            found["lag"] = (row.value, low, high)
    return found


def identified_as(kind: ModelKind, trials: Sequence[Trial], device: DrawnDevice, seed: int) -> Identified:
    """A model of a kind, from a device's trials.

    Raises:
        FitError: if it cannot be identified.
        KeyboardInterrupt: if the user ended it.
    """
    command = Range(lower=device.limits.lower, upper=device.limits.upper)
    limits = DeviceLimits(command, device.rate_per_s)
    found = kind.fit(trials, FitRequest(training=kind.trainings[0], seed=seed, limits=limits))
    if found.interrupted:
        raise KeyboardInterrupt
    return found


def opened_model(identified: Identified, stem: Path) -> Knowledge:
    """The model written, and opened as a user opens it."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    file = stem.with_name(stem.name + (".onnx" if identified.simulator is None else ".yaml"))
    if identified.simulator is None:
        export_onnx(identified.bundle, file)
    else:
        save_simulator(identified.simulator, file)
    return knowledge(str(file))


def _model_controllers(study: DeviceStudy) -> dict[str, Controller[Any]]:
    """The predictive controllers with default settings, the inverse alone, and the one that knows the device."""
    limits = study.device.limits
    return {
        "linearised": _built(LinearisedMpcSettings(), study.model, limits),
        "sampling": _built(SamplingMpcSettings(), study.model, limits),
        "inverse": _built(InverseControllerSettings(), study.model, limits),
        "exact": exact_controller(study.device, LinearisedMpcSettings()),
    }


def _built(settings: LawSettings, known: Knowledge, limits: CommandLimits) -> Controller[Any]:
    predictive = isinstance(settings, LinearisedMpcSettings | SamplingMpcSettings)
    pair = (known.predictor, known.inverse) if predictive else known.feedforward
    return build_controller(settings, *pair, limits)


def tuned_rivals(study: DeviceStudy, settings: IdentifySettings) -> dict[str, Controller[Any]]:
    """PID, and inverse with PID, their gains searched on the very device and motions under another noise."""
    found: dict[str, Controller[Any]] = {}
    starts: dict[str, PidLike] = {"pid": PidControllerSettings(), "inverse_pid": InversePidControllerSettings()}
    for name, start in starts.items():
        cases = [_PidCase.of(study, motion, start) for motion in study.motions]

        def mean_square(tried: PidLike, cases: Sequence[_PidCase] = cases) -> float:
            return float(np.mean([case.mean_square(tried.gains) for case in cases]))

        best = searched_gains(start, mean_square, settings.evaluations, settings.seed)
        found[name] = _built(best.settings, study.rival, study.device.limits)
    return found


@dataclass(frozen=True, eq=False)
class _PidCase:
    """One motion of the search: what of a run does not depend on the gains."""

    plant: DrawnPlant
    arrays: tuple[Any, ...]  # wanted, due, feedforward, noise
    first: int

    @classmethod
    def of(cls, study: DeviceStudy, motion: CountedMotion, settings: PidLike) -> _PidCase:
        plant = study.plant.reseeded(study.device.seed + _TUNING)
        wanted = motion.wanted(plant.dt)
        due, feedforward = wanted, np.full(wanted.size, study.device.limits.lower)
        if isinstance(settings, InversePidControllerSettings):
            # With gains of zero the feedback is silent, and what is sent is the feedforward.
            silent = PidSettings(kp_per_deg=0.0, ki_per_deg_s=0.0, kd_s_per_deg=0.0)
            alone = _built(settings.model_copy(update={"gains": silent}), study.rival, study.device.limits)
            feedforward = run_closed_loop(alone, plant, motion.trajectory).log.command
            due = np.concatenate([[np.nan], wanted[:-1]])
        return cls(plant, (wanted, due, feedforward, plant.noise(wanted.size)), motion.first(plant.dt))

    def mean_square(self, gains: PidSettings) -> float:
        limits, dt = self.plant.device.limits, self.plant.dt
        numbers = PidNumbers(
            *(gains.kp_per_deg, gains.ki_per_deg_s, gains.kd_s_per_deg, gains.filter_s, gains.tracking_s),
            *(gains.dead_zone_deg, limits.lower, limits.upper, limits.rate * dt, dt),
        )
        angle, rest = self.plant.rest
        return float(kernels.pid_square_error(self.plant.packed, rest, *self.arrays, self.first, numbers, angle))


def _along(
    name: str, controller: Controller[Any], plant: ComputedPlant, study: DeviceStudy, delay_s: float
) -> dict[str, float]:
    """Figures of a controller over all motions, `name` before each."""
    runs: list[ClosedLoopRun] = []
    for motion in study.motions:
        runs.append(run_closed_loop(controller, plant, motion.trajectory))
        if runs[-1].log.interrupted:
            raise KeyboardInterrupt
    lag = study.device.lag_s
    found = scores(runs, study.motions, study.device.limits, delay_s, lag)
    return {f"{name}.{figure}": value for figure, value in found.items()}


def _as_identified(study: DeviceStudy) -> dict[str, float]:
    """The default controller and the inverse alone on a plant that is the identified model, with noise."""
    plant = IdentifiedPlant(study.model, study.plant.true_angle, AS_IDENTIFIED_NOISE_DEG, study.device.seed)
    limits = study.device.limits
    figures: dict[str, float] = {}
    for name, settings in (("linearised", LinearisedMpcSettings()), ("inverse", InverseControllerSettings())):
        figures |= _along(f"as_identified_{name}", _built(settings, study.model, limits), plant, study, 0.0)
    return figures


def as_result(job: IdentifyJob, settings: IdentifySettings) -> IdentifyResult:
    """A result that says what the device is, and nothing else yet."""
    device = draw_devices(settings.devices, settings.seed, settings.quick)[job.number]
    facts: dict[str, str | float] = {
        "family": device.family,
        "rate_hz": device.rate_hz,
        "noise_deg": device.noise_deg,
        "servo_damping": device.damping,
        "creep_s": device.creep_s,
        "rate_per_s": device.rate_per_s,
    }
    return IdentifyResult(job, fingerprint(job, settings), "failed", "", 0.0, device.truth, {}, facts)

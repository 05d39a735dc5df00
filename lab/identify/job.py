"""Job of one random device: identification from its logs, control as identified and by tuned rivals, figures."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from hystmpc.ctrl.build import build_controller, pair_for
from hystmpc.ctrl.command import CommandLimits, Source
from hystmpc.ctrl.feedback import (
    InverseControllerSettings,
    InversePidControllerSettings,
    PidControllerSettings,
    PidSettings,
)
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.law import LawSettings
from hystmpc.ctrl.loop import Controller, ImagingSettings, NoSensorSettings
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, SamplingMpcSettings
from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.kinds.catalogue import chosen_kind, kind_named
from hystmpc.models.kinds.kind import FitRequest, Identified, ModelKind
from hystmpc.models.prediction.build import ControllerModel, controller_model
from hystmpc.models.simulator import save_simulator
from hystmpc.sim.plants.computed import ComputedPlant, Sensing
from hystmpc.sim.results import holds, violations
from hystmpc.sim.study import ClosedLoopRun, run_closed_loop
from hystmpc.sim.tuning.gains import PidLike, searched_gains
from hystmpc.trajectories.drawn import CountedMotion
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..devices import kernels
from ..devices.drawn import DrawnDevice, DrawnPlant, drawn_devices
from ..devices.exact import exact_controller
from ..devices.kernels import PidNumbers
from ..devices.motions import fresh_motions, recordings
from .settings import IdentifyJob, IdentifySettings, Interval

AS_IDENTIFIED_NOISE_DEG = 0.15
SETTLED_S = 1.0
"""Time after which a hold has settled, beside the delay and three lags [s]."""

_AT_REST = 1e-6  # of the command's range


def scores(
    runs: Sequence[ClosedLoopRun],
    motions: Sequence[CountedMotion],
    limits: CommandLimits,
    delay_s: float,
    lag_s: float,
) -> dict[str, float]:
    """Figures of one controller over all motions; only samples after the approach count, except for limits and stops.

    `rmse_deg` is the root of the mean over motions of the mean square true error, `rmse_deg.MOTION` that of one.
    `hold_samples` are those of holds that have settled, until the command may prepare the next move, which is the delay
    and one lag earlier than the move itself; in `rest_samples` of them the command did not move. `violations` are
    samples beyond a limit, `stops` samples in which the controller gave up.
    """
    squares, held, resting, beyond, stops = dict[str, float](), 0, 0, 0, 0
    for run, motion in zip(runs, motions, strict=True):
        first = motion.first(run.dt)
        squares[motion.name] = float(np.mean(run.error_deg[first:] ** 2))
        still = np.abs(np.diff(run.log.command, prepend=run.rest_command)) <= _AT_REST * (limits.upper - limits.lower)
        settle, early = round((SETTLED_S + delay_s + 3 * lag_s) / run.dt), math.ceil((delay_s + lag_s) / run.dt) + 1
        for start, stop in holds(run.log.reference_deg, run.dt):
            part = still[max(start + settle, first) : max(stop - early, 0)]
            held, resting = held + part.size, resting + int(np.sum(part))
        beyond += violations(run.log.command, run.rest_command, limits, run.dt)
        stops += sum(source == Source.STOP for source in run.log.source)
    return {
        "rmse_deg": math.sqrt(float(np.mean(list(squares.values())))),
        **{f"rmse_deg.{name}": math.sqrt(square) for name, square in squares.items()},
        "hold_samples": float(held),
        "rest_samples": float(resting),
        "violations": float(beyond),
        "stops": float(stops),
    }


def tracked(
    name: str,
    controller: Controller[Any],
    plant: ComputedPlant,
    motions: Sequence[CountedMotion],
    device: DrawnDevice,
    delay_s: float | None = None,
    sensor: ImagingSettings | NoSensorSettings | None = None,
) -> tuple[dict[str, float], list[ClosedLoopRun]]:
    """Figures of a controller over all motions, with prefix `name`, and the runs.

    Args:
        device: whose limits and lag count.
        delay_s: of the plant [s]; the device's where left out.

    Raises:
        KeyboardInterrupt: if the user ended it.
    """
    runs = []
    for motion in motions:
        runs.append(run_closed_loop(controller, plant, motion.trajectory, sensor=sensor))
        if runs[-1].log.interrupted:
            raise KeyboardInterrupt
    figures = scores(runs, motions, device.limits, device.delay_s if delay_s is None else delay_s, device.lag_s)
    return {f"{name}.{figure}": value for figure, value in figures.items()}, runs


def controller_on(settings: LawSettings, known: ControllerModel, limits: CommandLimits) -> GuardedController:
    """Controller with a model: predictor and inverse as required by its law."""
    return build_controller(settings, *pair_for(settings, known), limits)


@final
class IdentifiedPlant(ComputedPlant):
    """Identified model in the role of the device.

    Args:
        rest_deg: angle that it rests at before a run, at its lowest command [deg].
        noise_deg: standard deviation of the sensor's white noise [deg].
    """

    def __init__(self, known: ControllerModel, rest_deg: float, noise_deg: float, seed: int) -> None:
        self._predictor, limits = known.predictive[0], known.facts.command_limits
        self._rest = self._predictor.advance(self._predictor.initial(rest_deg, limits.lower), limits.lower)
        self.command_limits = Range(lower=limits.lower, upper=limits.upper)
        super().__init__(self._predictor.dt, limits.lower, known.facts.command_unit, Sensing(noise_deg), seed)

    def _at_rest(self, random: np.random.Generator) -> tuple[float, Vec]:
        del random
        return self._rest

    def _advanced(self, state: Vec, u: float, random: np.random.Generator) -> tuple[float, Vec]:
        del random
        return self._predictor.advance(state, u)


_RIVAL_MODEL = "pi"
_TUNING, _COMPARED = 1001, 1  # seeds of the noise, beside the device's


@dataclass(frozen=True, eq=False)
class DeviceStudy:
    """Models and data of one device for the construction of its controllers.

    Attributes:
        model, rival: the identified model, and the Prandtl-Ishlinskii model that the inverse of the rivals is of.
    """

    device: DrawnDevice
    plant: DrawnPlant
    motions: tuple[CountedMotion, ...]
    model: ControllerModel
    rival: ControllerModel


@dataclass
class _Watch:
    """Processor time by stage [s]."""

    seconds: dict[str, float]
    last: float

    def lap(self, name: str) -> None:
        now = time.process_time()
        self.seconds[f"seconds.{name}"], self.last = now - self.last, now


def run_device(job: IdentifyJob, settings: IdentifySettings, folder: Path) -> dict[str, Any]:
    """Report of the identification, identified parts, and figures of all controllers; models are written."""
    device = drawn_devices(settings)[job.number]
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
        figures |= tracked(name, controller, plant, study.motions, device)[0]
        watch.lap(name)
    figures |= _as_identified(study)
    watch.lap("as_identified")
    return {"message": identified.report, "found": found_parts(identified), "figures": figures | watch.seconds}


def found_parts(identified: Identified) -> dict[str, Interval]:
    """Identified parts around the hysteresis: value and ends of the 90 % interval, by the names of `DrawnDevice.truth`.

    Parts that were not identified are left out.
    """
    parts: dict[str, Interval] = {}
    for row in identified.parts.parameters if identified.parts else ():
        low, high = row.ci90
        if (row.owner, row.name) in (("lag", "tau_s"), ("delay", "delay_s")):
            parts[row.owner] = (row.value, low, high)
        elif row.owner == "creep" and row.name.startswith("share"):
            before = parts.get("creep", (0.0, 0.0, 0.0))  # of two terms the sum; drawn shares have the other sign
            parts["creep"] = (before[0] - row.value, before[1] - high, before[2] - low)
        elif row.owner == "lag" and row.name in ("tau_up_s", "top_speed"):
            parts["lag"] = (row.value, low, high)
    return parts


def identified_as(kind: ModelKind, trials: Sequence[Trial], device: DrawnDevice, seed: int) -> Identified:
    """Identify a model of a kind from a device's trials.

    Raises:
        KeyboardInterrupt: if the user ended it.
    """
    command = Range(lower=device.limits.lower, upper=device.limits.upper)
    limits = DeviceLimits(command, device.rate_per_s)
    identified = kind.fit(trials, FitRequest(training=kind.trainings[0], seed=seed, limits=limits))
    if identified.interrupted:
        raise KeyboardInterrupt
    return identified


def opened_model(identified: Identified, stem: Path) -> ControllerModel:
    """Write the model, and open its file as a user does."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    file = stem.with_name(stem.name + (".onnx" if identified.simulator is None else ".yaml"))
    if identified.simulator is None:
        export_onnx(identified.bundle, file)
    else:
        save_simulator(identified.simulator, file)
    return controller_model(str(file))


def _model_controllers(study: DeviceStudy) -> dict[str, Controller[Any]]:
    """Predictive controllers with default settings, the inverse alone, and the one with the exact device."""
    limits = study.device.limits
    return {
        "linearised": controller_on(LinearisedMpcSettings(), study.model, limits),
        "sampling": controller_on(SamplingMpcSettings(), study.model, limits),
        "inverse": controller_on(InverseControllerSettings(), study.model, limits),
        "exact": exact_controller(study.device, LinearisedMpcSettings()),
    }


def tuned_rivals(study: DeviceStudy, settings: IdentifySettings) -> dict[str, Controller[Any]]:
    """PID, and inverse with PID, tuned on the same device and motions under another noise."""
    rivals: dict[str, Controller[Any]] = {}
    starts: dict[str, PidLike] = {"pid": PidControllerSettings(), "inverse_pid": InversePidControllerSettings()}
    for name, start in starts.items():
        cases = [_PidCase.of(study, motion, start) for motion in study.motions]

        def mean_square(tried: PidLike, cases: Sequence[_PidCase] = cases) -> float:
            return float(np.mean([case.mean_square(tried.gains) for case in cases]))

        best = searched_gains(start, mean_square, settings.evaluations, settings.seed)
        rivals[name] = controller_on(best.settings, study.rival, study.device.limits)
    return rivals


@dataclass(frozen=True, eq=False)
class _PidCase:
    """Part of one motion of the search that does not depend on the gains."""

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
            alone = controller_on(settings.model_copy(update={"gains": silent}), study.rival, study.device.limits)
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
        wanted, due, feedforward, noise = self.arrays
        return kernels.pid_square_error(
            self.plant.packed, rest, wanted, due, feedforward, noise, self.first, numbers, angle
        )


def _as_identified(study: DeviceStudy) -> dict[str, float]:
    """Default controller and inverse alone on a plant that is the identified model, with noise."""
    plant = IdentifiedPlant(study.model, study.plant.true_angle, AS_IDENTIFIED_NOISE_DEG, study.device.seed)
    figures: dict[str, float] = {}
    for name, settings in (("linearised", LinearisedMpcSettings()), ("inverse", InverseControllerSettings())):
        controller = controller_on(settings, study.model, study.device.limits)
        figures |= tracked(f"as_identified_{name}", controller, plant, study.motions, study.device, 0.0)[0]
    return figures

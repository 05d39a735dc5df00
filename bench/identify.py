"""Model and controllers from recorded trials: check, identification, diagnosis, controller files."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.ctrl.command import CommandLimits, attempt
from hystmpc.ctrl.feedback import InversePidControllerSettings, PidControllerSettings, PidSettings
from hystmpc.ctrl.linear.analysis import DeviceModel
from hystmpc.ctrl.linear.design import gains_by_margin
from hystmpc.ctrl.planner.reach import angles_at_rest
from hystmpc.ctrl.planner.settings import TipSettings, read_settings
from hystmpc.ctrl.two_axes.tip_controller import read_two_axis_settings
from hystmpc.gap.diagnose import diagnose_trials
from hystmpc.gap.diagnosis import Diagnosis
from hystmpc.gap.report.words import closed_sentence, headline, tracking_sentence
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.kinds.catalogue import chosen_kind
from hystmpc.models.kinds.kind import FitRequest, ModelKind
from hystmpc.models.load import load_model
from hystmpc.models.model import LoadedModel
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import load_simulator, save_simulator
from hystmpc.models.two_axes.model import has_two_axes
from hystmpc.rig.axes import PerAxis, each
from hystmpc.sim.config import SimulationConfig, TuningSettings
from hystmpc.sim.plants.simulated import SimulatedPlant
from hystmpc.sim.results import Limits
from hystmpc.sim.study import Study, prepare
from hystmpc.sim.tuning.gains import PidLike, PidTuning, mean_square_of, tuned_gains
from hystmpc.trajectories.point_to_point import PointToPoint
from hystmpc.trials.axes import both_axes
from hystmpc.trials.check import Severity, check
from hystmpc.trials.config import dump_yaml, read_yaml
from hystmpc.trials.errors import FitError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.read import at_rate
from hystmpc.trials.recording import recorded_trials
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, parts

from .config import CommissionBlock, CommissionSettings
from .device import AnyTip
from .motions import AnyMotion, AnyReached, ReachedAngles, references
from .stages import DIAGNOSIS, Figure

MODEL_FILE, FIXED_FILE = "model.yaml", "model.fixed.yaml"
_KIND = "auto"


@dataclass(frozen=True)
class Subject:
    """Device to be identified: limits, sample rate, recordings."""

    name: str
    command_unit: str  # mm or bar
    rate_hz: float
    limits: Limits  # range and rate in use; of two axes a pair
    safe_command: PerAxis  # rest of the device
    angle_limits: tuple[float, float] | None  # of the tip [deg]; None for no limits
    trials: tuple[Path, ...]  # files of the recordings
    block: CommissionBlock

    @property
    def axes(self) -> int:
        """Number of commands and angles."""
        return len(each(self.limits))

    @property
    def one_axis(self) -> CommandLimits:
        """Limits of the command of a device of one axis.

        Raises:
            FitError: of two axes.
        """
        if isinstance(self.limits, tuple):
            raise FitError(f"{self.name}: a device of two axes, expected one here")
        return self.limits


def subject_of(settings: CommissionSettings, limits: Limits, trials: Iterable[Path]) -> Subject:
    """Subject with these limits and recordings; all other data from the settings."""
    return Subject(
        name=settings.name,
        command_unit=settings.command_unit,
        rate_hz=settings.rate_hz,
        limits=limits,
        safe_command=settings.safe_command,
        angle_limits=settings.angle_limits,
        trials=tuple(trials),
        block=settings.commission,
    )


@dataclass(frozen=True)
class TrialCheck:
    """Result of the quality check: warnings with their files, number and duration of the trials."""

    warnings: tuple[str, ...]
    trials: int
    seconds: float


def check_trials(subject: Subject) -> TrialCheck:
    """Check the quality of all recordings, as `hystmpc check`.

    Raises:
        LogError: with the first fault if a recording cannot be used.
    """
    warnings: list[str] = []
    for file in subject.trials:
        for finding in check(file).findings:
            line = f"{file.name}: {finding.topic}: {finding.message}"
            if finding.severity is Severity.ERROR:
                raise LogError(f"check: {line}; expected a recording that can be used")
            if finding.severity is Severity.WARNING:
                warnings.append(line)
    trials = uniform_trials(subject)
    moved = max(float(np.ptp(trial.angles, axis=0).max()) for trial in trials)
    if all(np.ptp(trial.commands, axis=0).max() == 0 for trial in trials) or moved == 0:
        raise LogError("check: neither command nor angle moves, expected recordings of a motion")
    return TrialCheck(tuple(warnings), len(trials), sum(trial.duration_s for trial in trials))


def uniform_trials(subject: Subject) -> list[Trial]:
    """Recordings resampled to the rate of the device, of two axes with both commands and angles."""
    trials = at_rate(recorded_trials(subject.trials, most_axes=subject.axes), subject.rate_hz)
    return trials if subject.axes == 1 else both_axes(trials) or trials


Row = tuple[str, str, Figure, Figure]
Number = tuple[str, Figure, Figure, Figure]


@dataclass(frozen=True)
class FittedModel:
    """Result of the identification."""

    report: str  # one line: components, and the error on held-out trials
    parts: tuple[Row, ...]  # part, form, error without and with it on held-out trials [deg]
    numbers: tuple[Number, ...]  # name, value and ends of the interval of 90 %
    sensor_sigma_deg: Figure  # noise of the sensor according to the model, quantisation included [deg]
    model_sigma_deg: Figure  # error of its free run [deg], NaN where unknown
    advice: tuple[str, ...]  # quantities that these trials do not determine, and what to record for them
    sensor_step_deg: Figure = 0.0  # resolution of the sensor [deg]; 0 for a continuous one
    left_out_deg: Figure = math.nan  # error of two axes' free run on a motion left out, as a distance; NaN of one [deg]


def fit_model(subject: Subject, folder: Path, progress: Progress) -> FittedModel:
    """Identify the whole device and write `model.yaml`.

    Raises:
        FitError: if it cannot be identified.
        KeyboardInterrupt: if the user ended it; nothing is kept.
    """
    kind, request = fit_request(subject, subject.one_axis)
    trials = uniform_trials(subject)
    kind.check(trials, request)
    total = kind.steps(request) or 100
    fitted = kind.fit(trials, request, lambda done, rmse: progress(done, total, f"best {rmse:.4f} deg"))
    if fitted.interrupted:
        raise KeyboardInterrupt
    if fitted.simulator is None:
        raise FitError(f"{_KIND}: got no readable model, expected one")
    save_simulator(fitted.simulator, folder / MODEL_FILE)
    noise, parts = fitted.simulator.identification.noise, fitted.parts
    return FittedModel(
        report=fitted.report,
        parts=tuple((r.part, r.form, r.without_deg, r.with_deg) for r in (parts.rows if parts else ())),
        numbers=tuple((f"{r.owner} {r.name}", r.value, *r.ci90) for r in (parts.parameters if parts else ())),
        sensor_sigma_deg=math.nan if noise is None else noise.sensor_sigma_deg,
        model_sigma_deg=math.nan if noise is None or noise.model_sigma_deg is None else noise.model_sigma_deg,
        advice=parts.advice if parts else (),
        sensor_step_deg=0.0 if noise is None else noise.sensor_resolution_deg,
    )


def fit_request(subject: Subject, limits: CommandLimits) -> tuple[ModelKind, FitRequest]:
    """Kind of model of a commissioning, and the request of an axis with these limits."""
    kind = chosen_kind(_KIND, None, None)
    device = DeviceLimits(Range(lower=limits.lower, upper=limits.upper), limits.rate)
    return kind, FitRequest(training=kind.usual_training(False), seed=subject.block.seed, limits=device)


@dataclass(frozen=True)
class ModelDiagnosis:
    """Result of the diagnosis of the model's residual, in words."""

    verdict: tuple[str, ...]  # headline, reason, sizes of the gap, and the expected tracking error
    corrected: bool  # whether the corrected simulator is used: better on trials that influenced no choice
    next: str  # recording to make, empty without an open question


def diagnose_model(subject: Subject, model: Path, folder: Path, progress: Progress) -> ModelDiagnosis:
    """Diagnose the model's residual; write the diagnosis, and `model.fixed.yaml` where it is certified better.

    A model that cannot be diagnosed on these trials is no error: the verdict gives the reason.

    Raises:
        KeyboardInterrupt: if the user ended it; nothing is kept.
    """
    trials, simulator, seed = uniform_trials(subject), load_simulator(model), subject.block.seed
    done = diagnose_trials(
        trials,
        simulator,
        out=folder / DIAGNOSIS,
        called={"sim": str(model)},
        model=model,
        seed=seed,
        progress=progress,
    )
    diagnosis, corrected = done.diagnosis, done.data.fixed if certified(done.diagnosis) else None
    if corrected is not None:
        save_simulator(corrected, folder / FIXED_FILE)
    motion = diagnosis.next_motion
    return ModelDiagnosis(
        verdict=(headline(diagnosis), diagnosis.reason, closed_sentence(diagnosis), tracking_sentence(diagnosis)),
        corrected=corrected is not None,
        next="" if motion is None else f"record {folder.name}/{DIAGNOSIS}/{motion.file} ({motion.duration_s:.0f} s)",
    )


def certified(diagnosis: Diagnosis) -> bool:
    """Whether the corrected simulator is better on held-out trials, with the whole 90 % interval.

    A simulator cannot be corrected for a faulty sensor.
    """
    gap = diagnosis.gap
    better = gap.with_effects_rmse_deg < min(gap.nominal_rmse_deg, gap.retuned_rmse_deg)
    physical = any(effect.name != "sensor" for effect in diagnosis.effects)
    named = diagnosis.verdict in ("named", "one_of") and physical and bool(gap.final_trials)
    return named and better and gap.closed_ci90[0] > 0


def reached_angles(subject: Subject, model: Path) -> ReachedAngles:
    """Range of angles for references: reached by the model at rest, covered by the trials, within the limits.

    Raises:
        FitError: if nothing is left between them.
    """
    known, limits = controller_model(str(model)), subject.one_axis
    trained = known.facts.trained_angle
    rest = angles_at_rest(known.predictive[0], limits, trained.lower)
    allowed = subject.angle_limits or (-math.inf, math.inf)
    low, high = max(rest[0], trained.lower, allowed[0]), min(rest[1], trained.upper, allowed[1])
    if not low < high:
        raise FitError(
            f"model: rests between {rest[0]:.2f} and {rest[1]:.2f} deg, trials show {trained.lower:.2f} to "
            f"{trained.upper:.2f} deg, expected angles in common within the limits"
        )
    return ReachedAngles(low, high, (high - low) / (limits.upper - limits.lower) * limits.rate)


TIP_FILE = "tip.yaml"
_TUNING, _FRESH = 3, 4  # draws of references: those of the tuning, and those of the verification
_TUNED_S = 10.0  # of each tuning motion
_FULL_HZ = 50.0  # above it the search has fewer evaluations, so that it takes no longer
_INVERSE_SHARE = 4  # the search with an inverse costs more, and its result is not verified: a share of the evaluations
_TOLERANCE_DEG, _TOLERANCE_SIGMAS = 0.5, 3.0


@dataclass(frozen=True)
class ControllerFiles:
    """Result of the stage that writes the controller files."""

    reached: AnyReached  # range of angles for references
    pid: Mapping[str, float]  # gains, tuned on the identified model with its noise
    pid_rmse_deg: Figure  # of the true angle on that model [deg]
    inverse_pid: Mapping[str, float]
    inverse_pid_rmse_deg: Figure


@dataclass(frozen=True, eq=False)
class IdentifiedDevice:
    """Results of the stages without a device: model, diagnosis (None where left out), controllers.

    `model` is the file that the controllers use.
    """

    subject: Subject
    checked: TrialCheck
    fitted: FittedModel
    diagnosed: ModelDiagnosis | None
    made: ControllerFiles
    model: Path


def make_controllers(
    subject: Subject, model: Path, sigma_deg: float, folder: Path, progress: Progress
) -> ControllerFiles:
    """Write `tip.yaml` next to the stage's folder, and `pid.yaml`, `inverse.yaml` and `inverse_pid.yaml` into it.

    Raises:
        HystmpcError: if the model cannot be used.
        KeyboardInterrupt: if the user ended the search; nothing is kept.
    """
    reached = reached_angles(subject, model)
    step = sensor_step_deg(model)
    study = tuning_study(subject, model, reached, sigma_deg, step)
    shares = evaluations(subject)
    known, limits = load_model(model, "conditioned"), subject.one_axis
    starts: dict[str, PidLike] = {
        "pid": PidControllerSettings(gains=start_gains(known, limits, PidSettings())),
        "inverse_pid": InversePidControllerSettings(
            gains=start_gains(known, limits, InversePidControllerSettings().gains)
        ),
    }
    tuned = dict[str, PidTuning]()

    def named(done: float, total: float, note: str = "", /) -> None:
        progress(done, total, f"gains {note}".strip())

    for (name, start), part in zip(starts.items(), parts(named, list(shares.values())), strict=True):
        config = study.config.model_copy(update={"tune_pid": TuningSettings(evaluations=shares[name])})
        tuned[name] = rounding_ignored(tuned_gains(replace(study, config=config), start, part), study, step)
    gains = {name: one.settings.gains.model_dump() for name, one in tuned.items()}
    tolerance = target_tolerance_deg(sigma_deg)
    files: dict[Path, dict[str, Any]] = {
        folder / "pid.yaml": {"kind": "pid", "gains": gains["pid"]},
        folder / "inverse_pid.yaml": {"kind": "inverse_pid", "gains": gains["inverse_pid"]},
        folder / "inverse.yaml": {"kind": "inverse"},
        folder.parent / TIP_FILE: predictive(subject, gains["pid"]),
    }
    for file, controller in files.items():
        write_tip(file, model, controller, subject, reached, tolerance)
    return ControllerFiles(
        reached, gains["pid"], tuned["pid"].rmse_deg, gains["inverse_pid"], tuned["inverse_pid"].rmse_deg
    )


def evaluations(subject: Subject) -> dict[str, int]:
    """Closed-loop runs of the search of each controller's gains, about."""
    whole = max(round(subject.block.tune_evaluations * min(1.0, _FULL_HZ / subject.rate_hz)), 24)
    return {"pid": whole, "inverse_pid": max(whole // _INVERSE_SHARE, 24)}


def start_gains(model: LoadedModel, limits: CommandLimits, given: PidSettings) -> PidSettings:
    """Gains of a phase margin of 60 deg around a model, to begin a search with; `given` where it has none."""
    device = DeviceModel(model, 0.0, 0, 0.5 * (limits.lower + limits.upper))
    return attempt(lambda: gains_by_margin(device, limits, given))[0] or given


def predictive(subject: Subject, pid: Mapping[str, float]) -> dict[str, Any]:
    """Block `controller` of `tip.yaml`; angle limits of the user become soft limits of the plan.

    `pid` are the gains of the feedback for a model that does not predict the angle.
    """
    block: dict[str, Any] = {"kind": "linearised_mpc", "supervisor": {"pid": dict(pid)}}
    if subject.block.angle_limits_deg is not None:
        low, high = subject.block.angle_limits_deg
        block["weights"] = {"angle_lower_deg": low, "angle_upper_deg": high}
    return block


def write_tip(
    file: Path,
    model: Path,
    controller: Mapping[str, Any],
    subject: Subject,
    reached: ReachedAngles,
    tolerance_deg: float,
) -> Path:
    """Write the file of a `TipController` with a block `controller`; the model's name is relative to it."""
    limits = subject.one_axis
    data = {
        "model": os.path.relpath(model, file.parent),
        "controller": {**controller, "ladder": {"safe_command": subject.safe_command}},
        "limits": {"lower": limits.lower, "upper": limits.upper, "rate_per_s": limits.rate},
        "motion": reached.motion.model_dump(),
        "start_command": subject.safe_command,
        "tolerance_deg": tolerance_deg,
    }
    TipSettings.parse(data, str(file))
    return write_atomically(file, dump_yaml(data))


def target_tolerance_deg(sigma_deg: float) -> float:
    """How close to a target counts as settled with this noise of the sensor [deg]."""
    return float(f"{max(_TOLERANCE_DEG, _TOLERANCE_SIGMAS * sigma_deg):.3g}")


def tip_settings(file: Path) -> AnyTip:
    """Settings in a file of a `TipController`, of one axis or of two; the model's file name becomes absolute."""
    known = read_yaml(file)
    two = isinstance(known, Mapping) and has_two_axes(file.parent / str(known.get("model")))
    settings, folder = read_two_axis_settings(file) if two else read_settings(file)
    return settings.model_copy(update={"model": str((folder / settings.model).resolve())})


def fresh_references(subject: Subject, reached: AnyReached, motion_s: float) -> dict[str, AnyMotion]:
    """References for the verification, not used in identification and tuning; those of the user if given."""
    return references(reached, motion_s, (subject.block.seed, _FRESH), subject.block.motions)


def tuning_references(subject: Subject, reached: AnyReached) -> dict[str, AnyMotion]:
    """References for the search of gains."""
    return references(reached, _TUNED_S, (subject.block.seed, _TUNING))


def sensor_step_deg(model: Path) -> float:
    """Resolution of the sensor according to the model's file [deg]; 0 for a continuous sensor."""
    noise = load_simulator(model).identification.noise
    return 0.0 if noise is None else noise.sensor_resolution_deg


def rounding_ignored(tuned: PidTuning, study: Study, step_deg: float) -> PidTuning:
    """Tuned gains with a dead zone of half the sensor's resolution, and their error on the model.

    Without it the command oscillates in a hold, which the search, based on the error alone, does not detect.
    """
    gains = tuned.settings.gains.with_dead_zone(step_deg)
    if gains == tuned.settings.gains:
        return tuned
    settings = tuned.settings.model_copy(update={"gains": gains})
    return replace(tuned, settings=settings, rmse_deg=math.sqrt(mean_square_of(study, settings)))


def tuning_study(
    subject: Subject, model: Path, reached: ReachedAngles, sigma_deg: float, step_deg: float = 0.0
) -> Study:
    """Simulated study for the tuning: the identified model with the sensor's noise, references from its rest.

    `sigma_deg` is the noise of the sensor, quantisation included, and `step_deg` its resolution [deg].
    """
    limits = subject.one_axis
    plant = SimulatedPlant(load_simulator(model), commands=Range(lower=limits.lower, upper=limits.upper))
    motions = tuning_references(subject, reached)
    data: dict[str, Any] = {
        "plant": {
            "simulator": str(model),
            "noise_deg": math.sqrt(max(sigma_deg**2 - step_deg**2 / 12.0, 0.0)) if step_deg else sigma_deg,
            "quantisation_deg": step_deg,
        },
        "model": str(model),
        "motions": {name: _from_rest(motion, plant.true_angle).model_dump() for name, motion in motions.items()},
        "controllers": {"pid": {"kind": "pid"}},
        "limits": {"lower": limits.lower, "upper": limits.upper, "rate_per_s": limits.rate},
        "tune_pid": {"evaluations": subject.block.tune_evaluations},
        "seed": subject.block.seed,
    }
    return prepare(SimulationConfig.parse(data, "tuning"))


def _from_rest(motion: AnyMotion, rest_deg: float) -> AnyMotion:
    """Reference that begins at the rest angle of the device."""
    if isinstance(motion, PointToPoint):
        targets, holds = (motion.start_deg, *motion.targets_deg), (1.0, *motion.holds_s)
        return motion.model_copy(update={"start_deg": rest_deg, "targets_deg": targets, "holds_s": holds})
    return motion.model_copy(update={"start_deg": rest_deg})

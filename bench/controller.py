"""Controller files: the predictive controller on the identified model, and those that it is compared with."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hystmpc.ctrl.feedback import InversePidControllerSettings, PidControllerSettings
from hystmpc.ctrl.planner.settings import TipSettings, read_settings
from hystmpc.models.contract.metadata import Range
from hystmpc.models.simulator import load_simulator
from hystmpc.sim.config import SimulationConfig, TuningSettings
from hystmpc.sim.plants.simulated import SimulatedPlant
from hystmpc.sim.study import Study, prepare
from hystmpc.sim.tune_pid import PidLike, PidTuning, mean_square_of, tuned_gains
from hystmpc.trajectories.motion import MotionSettings
from hystmpc.trajectories.point_to_point import PointToPoint
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Progress

from .identify import FittedModel, ModelDiagnosis, Subject, TrialCheck, reached_angles
from .motions import ReachedAngles, references
from .stages import Figure

TIP_FILE = "tip.yaml"
_TUNING, _FRESH = 3, 4  # draws of references: those of the tuning, and those of the verification
_TUNED_S = 10.0  # of each tuning motion
_FULL_HZ = 50.0  # above it the search has fewer evaluations, so that it takes no longer
_INVERSE_SHARE = 4  # the search with an inverse costs more, and its result is not verified: a share of the evaluations
_TOLERANCE_DEG, _TOLERANCE_SIGMAS = 0.5, 3.0


@dataclass(frozen=True)
class ControllerFiles:
    """Result of the stage that writes the controller files.

    Attributes:
        reached: angles between which references may lie.
        pid, inverse_pid: gains, tuned on the identified model with its noise.
        pid_rmse_deg, inverse_pid_rmse_deg: of the true angle on that model [deg].
    """

    reached: ReachedAngles
    pid: Mapping[str, float]
    pid_rmse_deg: Figure
    inverse_pid: Mapping[str, float]
    inverse_pid_rmse_deg: Figure


@dataclass(frozen=True, eq=False)
class IdentifiedDevice:
    """Results of the stages without a device: model, diagnosis, controllers.

    Attributes:
        checked, fitted, diagnosed, made: results of the stages; no diagnosis where it was left out.
        model: file that the controllers use.
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
    whole = max(round(subject.block.tune_evaluations * min(1.0, _FULL_HZ / subject.rate_hz)), 24)
    shares = {"pid": whole, "inverse_pid": max(whole // _INVERSE_SHARE, 24)}
    starts: dict[str, PidLike] = {"pid": PidControllerSettings(), "inverse_pid": InversePidControllerSettings()}
    total, before, tuned = sum(shares.values()), 0, dict[str, PidTuning]()
    for name, start in starts.items():

        def report(done: float, of: float, note: str = "", before: int = before, share: int = shares[name]) -> None:
            progress(before + share * done / of, total, f"gains {note}".strip())

        config = study.config.model_copy(update={"tune_pid": TuningSettings(evaluations=shares[name])})
        tuned[name] = rounding_ignored(tuned_gains(replace(study, config=config), start, report), study, step)
        before += shares[name]
    gains = {name: one.settings.gains.model_dump() for name, one in tuned.items()}
    tolerance = max(_TOLERANCE_DEG, _TOLERANCE_SIGMAS * sigma_deg)
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


def predictive(subject: Subject, pid: Mapping[str, float]) -> dict[str, Any]:
    """Block `controller` of `tip.yaml`; angle limits of the user become soft limits of the plan.

    Args:
        pid: gains of the feedback that takes over where the model does not predict the angle.
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
    """Write the file of a `TipController`; the model's name is relative to it.

    Args:
        controller: its block `controller`, without the ladder.
    """
    limits = subject.limits
    data = {
        "model": os.path.relpath(model, file.parent),
        "controller": {**controller, "ladder": {"safe_command": subject.safe_command}},
        "limits": {"lower": limits.lower, "upper": limits.upper, "rate_per_s": limits.rate},
        "motion": reached.motion.model_dump(),
        "start_command": subject.safe_command,
        "tolerance_deg": float(f"{tolerance_deg:.3g}"),
    }
    TipSettings.parse(data, str(file))
    return write_atomically(file, dump_yaml(data))


def tip_settings(file: Path) -> TipSettings:
    """Read a file of a `TipController`; the model's name becomes absolute.

    Raises:
        ConfigError: if the file is not one.
    """
    settings, folder = read_settings(file)
    return settings.model_copy(update={"model": str((folder / settings.model).resolve())})


def fresh_references(subject: Subject, reached: ReachedAngles, motion_s: float) -> dict[str, MotionSettings]:
    """References for the verification, new to identification and tuning; those of the user where there are some."""
    return references(reached, motion_s, (subject.block.seed, _FRESH), subject.block.motions)


def sensor_step_deg(model: Path) -> float:
    """Resolution of the sensor according to the model's file [deg]; 0 for a continuous sensor."""
    noise = load_simulator(model).identification.noise
    return 0.0 if noise is None else noise.sensor_resolution_deg


def rounding_ignored(tuned: PidTuning, study: Study, step_deg: float) -> PidTuning:
    """Tuned gains with a dead zone of half the sensor's resolution, and their error on the model.

    Without it the command oscillates in a hold, which the search does not see: it looks at the error alone.
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

    Args:
        sigma_deg: noise of the sensor, the error of its steps included [deg].
        step_deg: step of its readings [deg].
    """
    limits = subject.limits
    plant = SimulatedPlant(load_simulator(model), commands=Range(lower=limits.lower, upper=limits.upper))
    motions = references(reached, _TUNED_S, (subject.block.seed, _TUNING))
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


def _from_rest(motion: MotionSettings, rest_deg: float) -> MotionSettings:
    """The reference, begun at the angle at which the device rests."""
    if isinstance(motion, PointToPoint):
        targets, holds = (motion.start_deg, *motion.targets_deg), (1.0, *motion.holds_s)
        return motion.model_copy(update={"start_deg": rest_deg, "targets_deg": targets, "holds_s": holds})
    return motion.model_copy(update={"start_deg": rest_deg})

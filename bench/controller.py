"""The controller files: the predictive controller on the identified model, and the rivals it is verified beside."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hystmpc.ctrl.feedback import PidControllerSettings
from hystmpc.ctrl.inverse_settings import InversePidControllerSettings
from hystmpc.ctrl.planner.settings import TipSettings, read_settings
from hystmpc.models.contract.metadata import Range
from hystmpc.models.simulator import load_simulator
from hystmpc.sim.config import SimulationConfig, TuningSettings
from hystmpc.sim.plants.simulated import SimulatedPlant
from hystmpc.sim.study import Study, prepare
from hystmpc.sim.tune_pid import PidLike, PidTuning, mean_square_of, tuned_gains
from hystmpc.trajectories.config import MotionSettings, PointToPointSettings
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Progress

from .identify import Checked, Diagnosed, Fitted, Subject, reached_angles
from .motions import Reached, references
from .stages import Figure

TIP_FILE = "tip.yaml"
_TUNING, _FRESH = 3, 4  # draws of references: those of the tuning, and those of the verification
_TUNED_S = 10.0  # of each tuning motion
_FULL_HZ = 50.0  # above it the search has fewer evaluations, so that it takes no longer
_INVERSE_SHARE = 4  # the search beside an inverse costs more and is not verified: a share of the evaluations
_TOLERANCE_DEG, _TOLERANCE_SIGMAS = 0.5, 3.0


@dataclass(frozen=True)
class ControllerMade:
    """The files of the controllers, and where they come from.

    Attributes:
        reached: angles between which references may lie.
        pid, inverse_pid: gains, found on the identified model with its noise.
        pid_rmse_deg, inverse_pid_rmse_deg: of the true angle on that model [deg].
    """

    reached: Reached
    pid: Mapping[str, float]
    pid_rmse_deg: Figure
    inverse_pid: Mapping[str, float]
    inverse_pid_rmse_deg: Figure


@dataclass(frozen=True, eq=False)
class Identified:
    """The device as identified, with its controllers.

    Attributes:
        checked, fitted, diagnosed, made: results of the stages; no diagnosis where it was left out.
        model: file that the controllers use.
    """

    subject: Subject
    checked: Checked
    fitted: Fitted
    diagnosed: Diagnosed | None
    made: ControllerMade
    model: Path


def make_controllers(
    subject: Subject, model: Path, sigma_deg: float, folder: Path, progress: Progress
) -> ControllerMade:
    """Write `tip.yaml` beside the stage's folder, and in it `pid.yaml`, `inverse.yaml` and `inverse_pid.yaml`.

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
    total, before, found = sum(shares.values()), 0, dict[str, PidTuning]()
    for name, start in starts.items():

        def told(done: float, of: float, note: str = "", before: int = before, share: int = shares[name]) -> None:
            progress(before + share * done / of, total, f"gains {note}".strip())

        config = study.config.model_copy(update={"tune_pid": TuningSettings(evaluations=shares[name])})
        found[name] = with_wider_dead_zone(tuned_gains(replace(study, config=config), start, told), study, step)
        before += shares[name]
    gains = {name: tuned.settings.gains.model_dump() for name, tuned in found.items()}
    tolerance = max(_TOLERANCE_DEG, _TOLERANCE_SIGMAS * sigma_deg)
    files: dict[Path, dict[str, Any]] = {
        folder / "pid.yaml": {"kind": "pid", "gains": gains["pid"]},
        folder / "inverse_pid.yaml": {"kind": "inverse_pid", "gains": gains["inverse_pid"]},
        folder / "inverse.yaml": {"kind": "inverse"},
        folder.parent / TIP_FILE: predictive(subject, gains["pid"]),
    }
    for file, controller in files.items():
        write_tip(file, model, controller, subject, reached, tolerance)
    return ControllerMade(
        reached, gains["pid"], found["pid"].rmse_deg, gains["inverse_pid"], found["inverse_pid"].rmse_deg
    )


def predictive(subject: Subject, pid: Mapping[str, float]) -> dict[str, Any]:
    """The controller block of `tip.yaml`; angle limits that the user has given are soft limits of the plan.

    Args:
        pid: gains of the feedback to which it hands over where its model foretells nothing.
    """
    block: dict[str, Any] = {"kind": "linearised_mpc", "supervisor": {"pid": dict(pid)}}
    if subject.block.angle_limits_deg is not None:
        low, high = subject.block.angle_limits_deg
        block["weights"] = {"angle_lower_deg": low, "angle_upper_deg": high}
    return block


def write_tip(
    file: Path, model: Path, controller: Mapping[str, Any], subject: Subject, reached: Reached, tolerance_deg: float
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
    """Settings of such a file, the model's name absolute.

    Raises:
        ConfigError: if the file is not one.
    """
    settings, folder = read_settings(file)
    return settings.model_copy(update={"model": str((folder / settings.model).resolve())})


def fresh_references(subject: Subject, reached: Reached, motion_s: float) -> dict[str, MotionSettings]:
    """References that neither the identification nor the tuning has seen; the user's own where there are some."""
    return references(reached, motion_s, (subject.block.seed, _FRESH), subject.block.motions)


def sensor_step_deg(model: Path) -> float:
    """Step of the sensor's readings, as the model's file says [deg]; 0 of a continuous sensor."""
    noise = load_simulator(model).identification.noise
    return 0.0 if noise is None else noise.sensor_resolution_deg


def with_wider_dead_zone(found: PidTuning, study: Study, step_deg: float) -> PidTuning:
    """Gains that do not integrate half a step of the sensor's readings, so that a hold rests; their error on the model.

    The search looks at the error alone, which a command that hunts around a reading may even lower.
    """
    gains = found.settings.gains.with_dead_zone(step_deg)
    if gains == found.settings.gains:
        return found
    settings = found.settings.model_copy(update={"gains": gains})
    return replace(found, settings=settings, rmse_deg=math.sqrt(mean_square_of(study, settings)))


def tuning_study(subject: Subject, model: Path, reached: Reached, sigma_deg: float, step_deg: float = 0.0) -> Study:
    """The identified model with the sensor as the device, and references of the same kinds from its rest.

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
    """The reference with an approach from where the device rests."""
    if isinstance(motion, PointToPointSettings):
        targets, holds = (motion.start_deg, *motion.targets_deg), (1.0, *motion.holds_s)
        return motion.model_copy(update={"start_deg": rest_deg, "targets_deg": targets, "holds_s": holds})
    return motion.model_copy(update={"start_deg": rest_deg})

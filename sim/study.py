"""A closed-loop study made ready: files opened, models compiled, controllers built; nothing runs yet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import AnyControllerSettings, LimitsSettings
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.limits import CommandLimits
from hystmpc.models.contract.metadata import Range
from hystmpc.models.library import model_path
from hystmpc.models.load import load_model
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.prediction.build import predictor_and_inverse
from hystmpc.models.simulator import load_simulator
from hystmpc.trajectories import PreviewTable, Trajectory
from hystmpc.trials.errors import ConfigError, ControllerError

from .config import SimulationConfig
from .plant import Effects, SimulatedPlant


@dataclass(frozen=True, eq=False)
class Study:
    """What `compare` and `tune_pid` run.

    Attributes:
        config: the settings, with the limits that hold.
        plant: the device.
        predictor, inverse: what controllers know of it.
        limits: hard limits of the device.
        motions: references by name.
        files: model files that were opened.
    """

    config: SimulationConfig
    plant: SimulatedPlant
    predictor: Predictor
    inverse: Inverse
    limits: CommandLimits
    motions: Mapping[str, Trajectory]
    files: tuple[Path, ...]

    def controller(self, settings: AnyControllerSettings) -> GuardedController[Any]:
        """A controller on this study's model.

        Raises:
            ControllerError: if the settings contradict each other or go beyond the limits.
        """
        return build_controller(settings, self.predictor, self.inverse, self.limits)

    def steps(self, motion: str) -> int:
        """Samples that a motion takes."""
        return PreviewTable(self.motions[motion], self.plant.dt, 1).steps


def prepare(config: SimulationConfig) -> Study:
    """Open and build everything that a study needs; whatever is wrong is found here.

    Raises:
        ModelError: if a model file is missing or unusable.
        ConfigError: if plant and model differ in the command's unit, or a mismatch names an unknown parameter.
        TrajectoryError: if a motion cannot be built.
        ControllerError: if a controller is misconfigured.
        FitError: if a network has no `inverse` and none can be fitted.
    """
    files = [model_path(text) for text in (config.plant.simulator, config.model, config.inverse) if text is not None]
    device, model = load_simulator(files[0]), load_model(files[1], start="conditioned")
    facts = model.metadata
    if device.command_unit != facts.command_unit:
        raise ConfigError(
            f"plant {config.plant.simulator} takes {device.command_unit} and model {config.model} "
            f"{facts.command_unit}, expected one unit"
        )
    limits = config.limits or LimitsSettings(
        lower=facts.command_limits.lower, upper=facts.command_limits.upper, rate_per_s=facts.command_rate
    )
    effects = Effects(**config.plant.model_dump(exclude={"simulator"}))
    flexure = Range(lower=limits.lower, upper=limits.upper)
    predictor, inverse = predictor_and_inverse(model, load_simulator(files[2]) if config.inverse else None)
    study = Study(
        config=config.model_copy(update={"limits": limits}),
        plant=SimulatedPlant(device, effects, predictor.dt, flexure, config.seed),
        predictor=predictor,
        inverse=inverse,
        limits=CommandLimits(limits.lower, limits.upper, limits.rate_per_s),
        motions={name: motion.build() for name, motion in config.motions.items()},
        files=tuple(files),
    )
    for name, settings in config.controllers.items():
        _check_controller(study, name, settings)
    return study


def _check_controller(study: Study, name: str, settings: AnyControllerSettings) -> None:
    """Build it once, so that a wrong one is found before the others have run for a minute."""
    try:
        study.controller(settings)
    except ControllerError as error:
        raise ControllerError(f"controllers.{name}: {error}") from None

"""A closed-loop study made ready: files opened, models compiled, controllers built; nothing runs yet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import AnyControllerSettings, LimitsSettings, LinearisedMpcSettings, SamplingMpcSettings
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.limits import CommandLimits
from hystmpc.models.chain_model import ChainModel
from hystmpc.models.contract.load import OnnxModel
from hystmpc.models.contract.metadata import Range
from hystmpc.models.inverse.shadow import shadow_simulator
from hystmpc.models.library import model_path
from hystmpc.models.load import AnyModel, load_model
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.prediction.actuated import ActuatedInverse, ActuatedPredictor
from hystmpc.models.prediction.build import predictor_and_inverse, predictor_for
from hystmpc.models.prediction.invertible import InvertiblePredictor
from hystmpc.models.simulator import Simulator, load_simulator
from hystmpc.trajectories import PreviewTable, Trajectory
from hystmpc.trials.errors import ConfigError, ControllerError

from .config import SimulationConfig
from .plant import Effects, SimulatedPlant, at_sample_time


@dataclass(frozen=True, eq=False)
class Study:
    """What `compare` and `tune_pid` run.

    Attributes:
        config: the settings, with the limits that hold.
        plant: the device.
        predictor, inverse: what predictive controllers know of it.
        feedforward: predictor and inverse of the controllers that only invert: the same for a model that has an
            inverse and for an inverse map, else the operator that stands in for it. Corrected by the network at every
            sample, as predictive controllers want it for their first guess, that inverse would go back and forth across
            the dead band.
        limits: hard limits of the device.
        motions: references by name.
        files: model files that were opened.
    """

    config: SimulationConfig
    plant: SimulatedPlant
    predictor: Predictor
    inverse: Inverse
    feedforward: tuple[Predictor, Inverse]
    limits: CommandLimits
    motions: Mapping[str, Trajectory]
    files: tuple[Path, ...]

    def controller(self, settings: AnyControllerSettings) -> GuardedController[Any]:
        """A controller on this study's model.

        Raises:
            ControllerError: if the settings contradict each other or go beyond the limits.
        """
        predictive = isinstance(settings, LinearisedMpcSettings | SamplingMpcSettings)
        predictor, inverse = (self.predictor, self.inverse) if predictive else self.feedforward
        return build_controller(settings, predictor, inverse, self.limits)

    def steps(self, motion: str) -> int:
        """Samples that a motion takes."""
        return PreviewTable(self.motions[motion], self.plant.dt, 1).steps


def prepare(config: SimulationConfig) -> Study:
    """Open and build everything that a study needs; whatever is wrong is found here.

    Raises:
        ModelError: if a model file is missing or unusable, or `inverse` is a forward model or of another unit.
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
    known, feedforward = _known(model, files[2] if config.inverse else None)
    predictor, inverse = _actuated(known, config.actuator_lag_s)
    study = Study(
        config=config.model_copy(update={"limits": limits}),
        plant=SimulatedPlant(device, effects, predictor.dt, flexure, config.seed),
        predictor=predictor,
        inverse=inverse,
        feedforward=_actuated(feedforward, config.actuator_lag_s),
        limits=CommandLimits(limits.lower, limits.upper, limits.rate_per_s),
        motions={name: motion.build() for name, motion in config.motions.items()},
        files=tuple(files),
    )
    for name, settings in config.controllers.items():
        _warm_up(study, name, settings)
    return study


def _actuated(model: tuple[Predictor, Inverse], lag_s: float) -> tuple[Predictor, Inverse]:
    """The model behind an actuator of known lag; the model itself where that is zero."""
    if lag_s == 0:
        return model
    predictor = ActuatedPredictor(model[0], lag_s)
    return predictor, ActuatedInverse(predictor, model[1])


def _known(model: AnyModel, inverse: Path | None) -> tuple[tuple[Predictor, Inverse], tuple[Predictor, Inverse]]:
    """What predictive controllers know, and what controllers know that only invert.

    Raises:
        ModelError: if the file of the inverse cannot be used.
    """
    companion = _companion(model) if inverse is None else _given_inverse(inverse, model.metadata.dt_s)
    known = predictor_and_inverse(model, companion)
    if isinstance(companion, Simulator):
        return known, predictor_and_inverse(ChainModel(companion))
    return known, known


def _given_inverse(file: Path, dt_s: float) -> Simulator | AnyModel:
    """A simulator to invert, or an inverse map.

    Raises:
        ModelError: if the file cannot be used.
    """
    given = load_model(file)
    if isinstance(given, OnnxModel):
        return given
    simulator = at_sample_time(given.simulator, dt_s)
    return ChainModel(simulator) if given.metadata.inverted else simulator


def _companion(model: AnyModel) -> Simulator | None:
    """A backlash that stands in where the model has no inverse of its own."""
    return None if isinstance(predictor_for(model), InvertiblePredictor) else shadow_simulator(model)


def _warm_up(study: Study, name: str, settings: AnyControllerSettings) -> None:
    """Build it and take a step: a wrong one is found before the others have run, and kernels are compiled by then."""
    try:
        controller, y = study.controller(settings), study.plant.reset()
        state = controller.init(y, study.plant.rest_command)
        controller.step(state, y, np.full(controller.horizon, y + 1.0))  # a reference at rest would plan nothing
    except ControllerError as error:
        raise ControllerError(f"controllers.{name}: {error}") from None

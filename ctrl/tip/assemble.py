"""From settings to everything that a `TipController` runs on; loads the heavy libraries and compiles the kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.chain_model import ChainModel
from hystmpc.models.contract.load import OnnxModel
from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.inverse.shadow import shadow_simulator
from hystmpc.models.library import model_path
from hystmpc.models.load import AnyModel, load_model
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators.delay import Delay
from hystmpc.models.prediction.actuated import ActuatedInverse, ActuatedPredictor
from hystmpc.models.prediction.build import predictor_and_inverse, predictor_for
from hystmpc.models.prediction.invertible import InvertiblePredictor
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import ControllerError

from ..build import build_controller
from ..config import AnyControllerSettings, LinearisedMpcSettings, SamplingMpcSettings
from ..guarded import GuardedController
from ..limits import CommandLimits
from .reach import Workspace, angles_at_rest
from .settings import TipSettings


@dataclass(frozen=True, eq=False)
class Assembly:
    """What a `TipController` runs on.

    Attributes:
        controller: law, estimator, ladder and limits.
        predictor: the model, for predictions asked for by a planner.
        limits: hard limits that the controller keeps.
        workspace: what bounds the angle.
        unit: of the command.
    """

    controller: GuardedController[Any]
    predictor: Predictor
    limits: CommandLimits
    workspace: Workspace
    unit: str


def assemble(settings: TipSettings, folder: Path) -> Assembly:
    """Open the files, build the controller and take one step with it, so that the first real one is not the slowest.

    Raises:
        ModelError: if a model file is missing or unusable.
        ControllerError: if the settings contradict each other or the model.
        FitError: if a network has no `inverse` and none can be fitted.
    """
    model = load_model(model_path(settings.model, folder), start="conditioned")
    facts = model.metadata
    companion = _companion(model, settings, folder)
    pair = predictor_and_inverse(model, companion)
    predictive = isinstance(settings.controller, LinearisedMpcSettings | SamplingMpcSettings)
    # corrected by the network at every sample, a stand-in's inverse alone would go back and forth in the dead band
    alone = companion if isinstance(companion, Simulator) and not predictive else None
    known = pair if alone is None else predictor_and_inverse(ChainModel(alone))
    predictor, inverse = _actuated(known, settings.actuator_lag_s)
    device = _device_limits(settings, facts)
    controller = build_controller(settings.controller, predictor, inverse, device)
    own = settings.controller.limits
    limits = device if own is None else CommandLimits(own.lower, own.upper, own.rate_per_s)
    trained = facts.trained_angle.lower, facts.trained_angle.upper
    ends = angles_at_rest(predictor, limits, trained[0])
    _warm_up(controller, ends[0], limits)
    return Assembly(
        controller, predictor, limits, Workspace(ends, _soft(settings.controller), trained), facts.command_unit
    )


def _companion(model: AnyModel, settings: TipSettings, folder: Path) -> Simulator | AnyModel | None:
    """What is inverted or asked in the model's place; None where the model has an inverse of its own."""
    if settings.inverse is None:
        return None if isinstance(predictor_for(model), InvertiblePredictor) else shadow_simulator(model)
    given, dt = load_model(model_path(settings.inverse, folder)), model.metadata.dt_s
    if isinstance(given, OnnxModel):
        return given
    simulator = _at_sample_time(given.simulator, dt)
    return ChainModel(simulator) if given.metadata.inverted else simulator


def _at_sample_time(simulator: Simulator, dt_s: float) -> Simulator:
    """The simulator at another sample time: delays get the store that they need at it."""
    chain = simulator.chain
    before, after = (
        tuple(Delay.at_rate(o.delay_s, dt_s) if isinstance(o, Delay) else o for o in side)
        for side in (chain.before, chain.after)
    )
    return replace(simulator, chain=replace(chain, before=before, after=after), dt_s=dt_s)


def _actuated(model: tuple[Predictor, Inverse], lag_s: float) -> tuple[Predictor, Inverse]:
    """The model behind an actuator of known lag; the model itself where that is zero."""
    if lag_s == 0:
        return model
    predictor = ActuatedPredictor(model[0], lag_s)
    return predictor, ActuatedInverse(predictor, model[1])


def _device_limits(settings: TipSettings, facts: ModelMetadata) -> CommandLimits:
    own = settings.limits
    if own is not None:
        return CommandLimits(own.lower, own.upper, own.rate_per_s)
    return CommandLimits(facts.command_limits.lower, facts.command_limits.upper, facts.command_rate)


def _soft(settings: AnyControllerSettings) -> tuple[float, float]:
    """Soft angle limits [deg]; infinite where the controller has none."""
    if not isinstance(settings, LinearisedMpcSettings | SamplingMpcSettings):
        return -math.inf, math.inf
    low, high = settings.weights.angle_lower_deg, settings.weights.angle_upper_deg
    return -math.inf if low is None else low, math.inf if high is None else high


def _warm_up(controller: GuardedController[Any], rest_deg: float, limits: CommandLimits) -> None:
    """Two steps from rest along a reference that moves: kernels are compiled and workspaces built by then."""
    state, wanted = controller.init(rest_deg, limits.lower), rest_deg + np.arange(1.0, controller.horizon + 1)
    _, state = controller.step(state, rest_deg, wanted)
    command, state = controller.step(state, rest_deg, wanted)
    if state.ladder.failures:
        raise ControllerError(f"controller: its first step fails on this model: {command.status}")

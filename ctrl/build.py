"""From settings and a model to a controller; everything that can be wrong is found here, before the first sample."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.load import load_model
from hystmpc.models.model import Inverse, LoadedModel, Predictor
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.prediction.build import Known, known_pairs
from hystmpc.models.simulator import ChainModel, Simulator
from hystmpc.trials.errors import ControllerError, ModelError

from .fallback import FallbackChain
from .from_outside import PythonControllerSettings
from .guarded import GuardedController
from .law import LawSettings
from .limits import CommandLimits, LimitsSettings, ModelledLimitsSettings


def build_controller(
    settings: LawSettings | PythonControllerSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> GuardedController[Any]:
    """The controller that `settings` describe.

    Args:
        settings: one of the classes of `CONTROLLERS`, or a class of yours derived from `LawSettings`.
        predictor: the model; PID takes only the sample time from it.
        inverse: its inverse, for feedforward, candidate plans and fallback.
        limits: hard limits of the device; `settings.limits` may narrow them.

    Raises:
        ControllerError: if the settings contradict each other or go beyond the device's limits.
    """
    settings = settings.resolved()
    limits = _narrowed(limits, settings.limits)
    predictor, inverse = settings.model_pair(predictor, inverse)
    fallback = FallbackChain(limits, settings.ladder, inverse if settings.falls_back_on_inverse else None)
    law, observer = settings.law(predictor, inverse, limits), settings.observer(predictor)
    return GuardedController(law, observer, fallback, limits, predictor.dt, settings.bridged_samples(predictor.dt))


def _narrowed(device: CommandLimits, wanted: LimitsSettings | None) -> CommandLimits:
    if wanted is None:
        return device
    limits = wanted.build()
    if not device.contains(limits):
        raise ControllerError(f"limits: got {limits}, expected them within those of the device, {device}")
    return limits


def limits_of_model(facts: ModelMetadata) -> CommandLimits:
    """The limits that a model was made for."""
    return CommandLimits(facts.command_limits.lower, facts.command_limits.upper, facts.command_rate)


def modelled_limits(settings: ModelledLimitsSettings | None, model: CommandLimits) -> CommandLimits:
    """Hard limits of command and rate: those of the settings; those of the model where they are left out.

    Raises:
        ControllerError: if the settings go beyond the model and do not say that they may.
    """
    if settings is None:
        return model
    limits = settings.build()
    if not (settings.beyond_model or model.contains(limits)):
        raise ControllerError(
            f"limits: got {limits}, expected them within what the model was made for, {model}; "
            "limits.beyond_model: true allows more"
        )
    return limits


def known_model(model: LoadedModel, inverse: Path | None, lag_s: float) -> Known:
    """Predictors and inverses of a model.

    Args:
        model: loaded with start "conditioned".
        inverse: file of what is inverted in the model's place; a backlash fitted to it where it needs one and has none.
        lag_s: first-order lag of the command that the model does not contain; 0 for none.

    Raises:
        ModelError: if the file of the inverse cannot be used, or the model's output is not in deg.
        FitError: if no stand-in can be fitted.
    """
    facts = model.metadata
    if facts.angle_unit != "deg" and not facts.inverted:
        raise ModelError(
            f"the model maps {facts.command_unit} to {facts.angle_unit}, expected an output in deg: a tip is "
            "steered by its angle"
        )
    known = known_pairs(model, None if inverse is None else _given_inverse(inverse, model.metadata.dt_s))
    return known.behind((Lag(lag_s),), model.metadata) if lag_s else known


def _given_inverse(file: Path, dt_s: float) -> Simulator | LoadedModel:
    """A simulator to invert, or an inverse map."""
    given = load_model(file)
    if not isinstance(given, ChainModel):
        return given
    simulator = given.simulator.at_sample_time(dt_s)
    return ChainModel(simulator) if given.metadata.inverted else simulator

"""From settings to everything that a `TipController` runs on; loads the heavy libraries and compiles the kernels."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.contract.metadata import rest_within
from hystmpc.models.load import load_model, model_path
from hystmpc.models.model import Predictor
from hystmpc.models.prediction.build import controller_model
from hystmpc.trials.errors import ControllerError

from ..command import CommandLimits, limits_of_model, modelled_limits, narrowed_limits
from ..guarded import GuardedController, build_controller, pair_for
from ..planning_settings import PredictiveSettings, WeightsSettings
from .reach import Workspace, angles_at_rest
from .settings import TipSettings


@dataclass(frozen=True, eq=False)
class Assembly:
    """What a `TipController` runs on.

    Attributes:
        controller: law, estimator, fallbacks and limits.
        predictor: the model, for predictions asked for by a planner.
        limits: hard limits that the controller keeps.
        workspace: what bounds the angle.
        unit: of the command.
        model_limits: what the model was made for; `limits` may be narrower, and wider where the settings say so.
        rest_command: at which the device rests, as the model's file says; None where it does not.
        model_hash: of the files that were opened.
    """

    controller: GuardedController[Any]
    predictor: Predictor
    limits: CommandLimits
    workspace: Workspace
    unit: str
    model_limits: CommandLimits
    model_hash: str = ""
    rest_command: float | None = None

    @property
    def rests_at(self) -> float:
        """Command that the device holds before the first step, where the settings do not say it."""
        return rest_within(self.rest_command, self.limits.lower, self.limits.upper)

    def origin(self, settings: TipSettings) -> str:
        """Kind and fingerprint of a controller: equal where settings, limits and model are."""
        controller = settings.model_dump_json(
            exclude={"model", "inverse", "limits", "motion", "start_command", "tolerance_deg"}
        )
        facts = (controller, self.limits, self.controller.dt, type(self.predictor).__qualname__, self.model_hash)
        return f"{settings.controller.kind} {hashlib.sha256(repr(facts).encode()).hexdigest()[:12]}"


def assemble(settings: TipSettings, folder: Path) -> Assembly:
    """Open the files, build the controller and take one step with it, so that the first real one is not the slowest.

    Raises:
        ModelError: if a model file is missing or unusable.
        ControllerError: if the settings contradict each other or the model, or limits go beyond the model's unasked.
        FitError: if a network has no `inverse` and none can be fitted.
    """
    model = load_model(model_path(settings.model, folder), start="conditioned")
    facts = model.metadata
    file = None if settings.inverse is None else model_path(settings.inverse, folder)
    wanted = settings.controller.resolved()
    predictor, inverse = pair_for(wanted, controller_model(model, file, settings.actuator_lag_s))
    made_for = limits_of_model(facts)
    device = modelled_limits(settings.limits, made_for)
    controller = build_controller(wanted, predictor, inverse, device)
    limits = narrowed_limits(device, wanted.limits)
    weights = wanted.weights if isinstance(wanted, PredictiveSettings) else WeightsSettings()
    soft = weights.angle_limits_deg
    trained = facts.trained_angle.lower, facts.trained_angle.upper
    ends = angles_at_rest(predictor, limits, trained[0])
    _warm_up(controller, ends[0], limits)
    files = [model_path(settings.model, folder)] + ([] if file is None else [file])
    return Assembly(
        controller,
        predictor,
        limits,
        Workspace(ends, soft, trained),
        facts.command_unit,
        made_for,
        " ".join(hashlib.sha256(path.read_bytes()).hexdigest() for path in files),
        facts.rest_command,
    )


def _warm_up(controller: GuardedController[Any], rest_deg: float, limits: CommandLimits) -> None:
    """Two steps from rest along a reference that moves: kernels are compiled and workspaces built by then."""
    state, wanted = controller.init(rest_deg, limits.lower), rest_deg + np.arange(1.0, controller.horizon + 1)
    _, state = controller.step(state, rest_deg, wanted)
    command, state = controller.step(state, rest_deg, wanted)
    if state.fallback.failures:
        raise ControllerError(f"controller: its first step fails on this model: {command.status}")

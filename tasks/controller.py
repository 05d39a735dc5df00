"""Controller of the tip angle from a model: `init` and `step` with explicit state."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystmpc.trials.errors import ControllerError

from .inputs import Model, opened

if TYPE_CHECKING:
    from hystmpc.ctrl.command import CommandLimits
    from hystmpc.ctrl.config import AnyControllerSettings
    from hystmpc.ctrl.guarded import GuardedController


def build_controller(
    controller: str | Mapping[str, Any] | AnyControllerSettings,
    model: Model,
    *,
    inverse: Path | str | None = None,
    limits: CommandLimits | None = None,
    actuator_lag_s: float = 0.0,
) -> GuardedController[Any]:
    """A controller of the tip angle: `init` and `step` with explicit state.

    Args:
        controller: `inverse`, `pid`, `inverse_pid`, `linearised_mpc` or `sampling_mpc`; or its settings.
        model: that it predicts with: a fit, simulator, opened model or file.
        inverse: file of what is inverted in the model's place, for a network.
        limits: hard limits of command and rate; those of the model where left out.
        actuator_lag_s: first-order lag of the command that the model does not contain [s].

    Raises:
        ConfigError: on an unknown controller or setting.
        ControllerError: if the settings contradict each other, or the limits go beyond the model's.
        ModelError: if a model cannot be used.
        FitError: if a network has no `inverse` and none can be fitted.
    """
    from hystmpc.ctrl.build import build_controller as build
    from hystmpc.ctrl.build import pair_for
    from hystmpc.ctrl.command import limits_of_model
    from hystmpc.ctrl.config import parse_controller
    from hystmpc.models.prediction.build import controller_model

    if isinstance(controller, str):
        controller = {"kind": controller}
    settings = parse_controller(dict(controller), "controller") if isinstance(controller, Mapping) else controller
    runs = opened(model, "conditioned")
    made_for = limits_of_model(runs.metadata)
    if limits is not None and not made_for.contains(limits):
        raise ControllerError(f"limits: got {limits}, expected them within what the model was made for, {made_for}")
    pair = pair_for(settings, controller_model(runs, inverse, actuator_lag_s))
    return build(settings, *pair, limits or made_for)

"""Settings of a `TipController` (YAML file or mapping), and the assembly of its parts."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from hystmpc.models.contract.metadata import rest_within
from hystmpc.trajectories.motion import MotionLimits
from hystmpc.trials.config import NotNegative, Positive, Settings, read_yaml
from hystmpc.trials.errors import ConfigError, ControllerError, shown

from ..command import CommandLimits, ModelledLimitsSettings, limits_of_model, modelled_limits, narrowed_limits
from ..config import ControllerSettings
from ..mpc_settings import LinearisedMpcSettings, PredictiveSettings, WeightsSettings
from .reach import Workspace, angles_at_rest

if TYPE_CHECKING:
    from hystmpc.models.model import Predictor

    from ..guarded import GuardedController


class TipSettings(Settings):
    """Settings of a `TipController`.

    Attributes:
        model: what is known of the device: a simulator (.yaml), an exported model (.onnx), or `builtin:NAME`.
        inverse: simulator (.yaml) that is inverted in the model's place, for networks, which have no inverse of their
            own; where left out, a backlash fitted to the network's free run. Or an inverse map (.onnx).
        actuator_lag_s: first-order lag of the command that the model does not contain.
        controller: a controller block, as in a simulation file.
        limits: hard limits of command and rate; those of the model where left out. Wider ones are refused unless
            `limits.beyond_model` is true.
        motion: limits of the reference's own motion.
        start_command: the command that the device holds before the first step; where left out, the model's
            `rest_command`, the lowest one where its file has none.
        tolerance_deg: how close the measured angle has to be to count as settled.
    """

    model: str
    inverse: str | None = None
    actuator_lag_s: NotNegative = 0.0
    controller: Annotated[ControllerSettings, Field(validate_default=True)] = LinearisedMpcSettings()
    limits: ModelledLimitsSettings | None = None
    motion: MotionLimits = MotionLimits()
    start_command: float | None = None
    tolerance_deg: Positive = 0.5


def read_settings(source: Path | str | Mapping[str, Any] | TipSettings) -> tuple[TipSettings, Path]:
    """Read the settings, and return the folder of their relative file names: the file's, else the present one.

    Raises:
        ConfigError: on an unreadable file, a model in place of settings, an unknown key (with the nearest right one),
            or a value out of bounds.
    """
    if isinstance(source, TipSettings):
        return source, Path()
    if isinstance(source, Mapping):
        return TipSettings.parse(dict(source)), Path()
    if not isinstance(source, str | Path):
        raise ConfigError(f"tip: got {shown(source)}, expected a YAML file, a mapping or TipSettings")
    data = {"format": "ONNX"} if Path(source).suffix.lower() == ".onnx" else read_yaml(source)
    if not isinstance(data, dict):
        raise ConfigError(f"{source}: got {type(data).__name__}, expected a mapping of settings")
    if "format" in data:
        raise ConfigError(
            f"{source}: got a model, format {shown(data['format'])}, expected the file of a controller; write one, "
            f"such as tip.yaml, with the line `model: {Path(source).name}`, and give that"
        )
    return TipSettings.parse(data, str(source)), Path(source).resolve().parent


def of_two_axes(source: object) -> bool:
    """Whether settings, a file or a mapping, name a model of two axes; what cannot be read names none."""
    from hystmpc.models.load import model_path
    from hystmpc.models.two_axes.model import has_two_axes

    data, folder = source, Path()
    if isinstance(source, str | Path):
        try:
            data, folder = read_yaml(source), Path(source).resolve().parent
        except ConfigError:
            return False
    model = data.get("model") if isinstance(data, Mapping) else None
    return isinstance(model, str) and not model.startswith("builtin:") and has_two_axes(model_path(model, folder))


@dataclass(frozen=True, eq=False)
class Assembly:
    """Parts of a `TipController`.

    Attributes:
        predictor: the model, for predictions requested by a planner.
        model_limits: of the model; `limits` may be narrower, and wider if the settings allow it.
        rest_command: rest command in the model's file; None without one.
        model_hash: of the files that were opened.
    """

    controller: GuardedController
    predictor: Predictor
    limits: CommandLimits
    workspace: Workspace
    unit: str
    model_limits: CommandLimits
    model_hash: str = ""
    rest_command: float | None = None

    @property
    def rests_at(self) -> float:
        """Command held before the first step, if the settings do not give it."""
        return rest_within(self.rest_command, self.limits.lower, self.limits.upper)

    def origin(self, settings: TipSettings) -> str:
        """Kind and fingerprint of a controller: equal for equal settings, limits and model."""
        controller = settings.model_dump_json(
            exclude={"model", "inverse", "limits", "motion", "start_command", "tolerance_deg"}
        )
        facts = (controller, self.limits, self.controller.dt, type(self.predictor).__qualname__, self.model_hash)
        return f"{settings.controller.kind} {hashlib.sha256(repr(facts).encode()).hexdigest()[:12]}"


def assemble(settings: TipSettings, folder: Path) -> Assembly:
    """Open the files, build the controller and warm it up by two steps.

    Raises:
        ModelError: if a model file is missing or unusable.
        ControllerError: if the settings contradict each other or the model, or limits go beyond the model's unasked.
        FitError: if a network has no `inverse` and none can be fitted.
    """
    # heavy libraries that settings alone do not need
    from hystmpc.models.load import load_model, model_path
    from hystmpc.models.prediction.build import controller_model

    from ..build import build_controller, pair_for

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


def _warm_up(controller: GuardedController, rest_deg: float, limits: CommandLimits) -> None:
    """Take two steps from rest along a moving reference: the engine is loaded, the solver has its workspace."""
    state, wanted = controller.init(rest_deg, limits.lower), rest_deg + np.arange(1.0, controller.horizon + 1)
    _, state = controller.step(state, rest_deg, wanted)
    command, state = controller.step(state, rest_deg, wanted)
    if state.head.failures:
        raise ControllerError(f"controller: its first step fails on this model: {command.status}")

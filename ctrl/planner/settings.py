"""Settings of a `TipController`: one YAML file or mapping."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from hystmpc.trajectories.motion import MotionLimits
from hystmpc.trials.config import NotNegative, Positive, Settings, read_yaml
from hystmpc.trials.errors import ConfigError, shown

from ..command import ModelledLimitsSettings
from ..config import ControllerSettings
from ..mpc_settings import LinearisedMpcSettings


class TipSettings(Settings):
    """Everything that a `TipController` is made from.

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
    """Settings, and the folder in which their relative file names start: that of the file, else the present one.

    Raises:
        ConfigError: on an unreadable file, an unknown key (with the nearest right one), or a value out of bounds.
    """
    if isinstance(source, TipSettings):
        return source, Path()
    if isinstance(source, Mapping):
        return TipSettings.parse(dict(source)), Path()
    if not isinstance(source, str | Path):
        raise ConfigError(f"tip: got {shown(source)}, expected a YAML file, a mapping or TipSettings")
    data = read_yaml(source)
    if not isinstance(data, dict):
        raise ConfigError(f"{source}: got {type(data).__name__}, expected a mapping of settings")
    return TipSettings.parse(data, str(source)), Path(source).resolve().parent

"""The table of controllers: their settings, told apart by `kind`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, get_args

from pydantic import Field

from hystmpc.trials.errors import ConfigError, did_you_mean

from .feedback.inverse_settings import InverseControllerSettings, InversePidControllerSettings
from .feedback.pid import PidControllerSettings
from .mpc_settings import LinearisedMpcSettings, SamplingMpcSettings

# A new controller is one class of settings, which builds it, and one line here; all that lists controllers reads this.
AnyControllerSettings = (
    InverseControllerSettings
    | PidControllerSettings
    | InversePidControllerSettings
    | LinearisedMpcSettings
    | SamplingMpcSettings
)
ControllerSettings = Annotated[AnyControllerSettings, Field(discriminator="kind")]
CONTROLLERS: dict[str, type[AnyControllerSettings]] = {
    kind.model_fields["kind"].default: kind for kind in get_args(AnyControllerSettings)
}


def parse_controller(data: Any, where: str = "<memory>") -> AnyControllerSettings:
    """Validate a mapping with the key `kind`.

    Raises:
        ConfigError: if it is no mapping, `kind` is missing or unknown, or a setting of that kind is wrong.
    """
    if not isinstance(data, dict) or "kind" not in data:
        raise ConfigError(f"{where}: expected a mapping with the key 'kind', {did_you_mean('', CONTROLLERS)}")
    kind = str(data["kind"])
    if kind not in CONTROLLERS:
        raise ConfigError(f"{where}: kind: got {kind!r}, {did_you_mean(kind, CONTROLLERS)}")
    return CONTROLLERS[kind].parse(data, where)


_SERVED = {
    "continuous": ("continuous", "intermittent", "none"),
    "intermittent": ("intermittent", "none"),
    "none": ("none",),
}


def sensor_fault(settings: AnyControllerSettings, kind: str) -> str:
    """Why a controller cannot work with a sensor of `kind`, empty where it can."""
    wanted, served = settings.estimator.sensor, _SERVED[kind]
    if wanted in served:
        return ""
    return f"estimator.sensor: got {wanted}, expected {' or '.join(served)}: the sensor is {kind}"


def told_of_sensor(block: Any, told: Mapping[str, Any]) -> Any:
    """The block of a controller with what its sensor says of itself, where the block does not say something else.

    Args:
        block: as it was given; what is no block of a known kind comes back as it is.
        told: keys of `estimator`; those that a controller of this kind does not know are left out.
    """
    ready = isinstance(block, AnyControllerSettings)
    data = {**block.model_dump(exclude_unset=True), "kind": block.kind} if ready else block
    if not told or not isinstance(data, Mapping) or str(data.get("kind")) not in CONTROLLERS:
        return block
    own = data.get("estimator", {})
    if not isinstance(own, Mapping):
        return block
    known = type(CONTROLLERS[str(data["kind"])]().estimator).model_fields
    return {**data, "estimator": {**{key: value for key, value in told.items() if key in known}, **own}}

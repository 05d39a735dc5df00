"""The table of controllers: their settings, told apart by `kind`."""

from __future__ import annotations

from typing import Annotated, Any, get_args

from pydantic import Field

from hystmpc.trials.errors import ConfigError, did_you_mean

from .feedback.inverse import InverseControllerSettings, InversePidControllerSettings
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

"""The table of controllers: their settings, told apart by `kind`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, get_args

from pydantic import BeforeValidator, Field

from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.from_outside import MEMORY, given_by, with_kind

from .feedback.inverse_settings import InverseControllerSettings, InversePidControllerSettings
from .feedback.pid import PidControllerSettings
from .from_outside import GROUP, PythonControllerSettings
from .mpc_settings import LinearisedMpcSettings, SamplingMpcSettings

# A new controller of the package is one class of settings, which builds it, and one line here; all that lists
# controllers reads this. Those from outside are `python`.
AnyControllerSettings = (
    InverseControllerSettings
    | PidControllerSettings
    | InversePidControllerSettings
    | LinearisedMpcSettings
    | SamplingMpcSettings
    | PythonControllerSettings
)
_KINDS: dict[str, type[AnyControllerSettings]] = {
    kind.model_fields["kind"].default: kind for kind in get_args(AnyControllerSettings)
}
CONTROLLERS = {name: kind for name, kind in _KINDS.items() if kind is not PythonControllerSettings}
"""Settings of the package's own controllers, by kind."""
_read = with_kind(CONTROLLERS, GROUP)
ControllerSettings = Annotated[AnyControllerSettings, Field(discriminator="kind"), BeforeValidator(_read)]


def parse_controller(data: Any, where: str = MEMORY) -> AnyControllerSettings:
    """Validate a mapping with the key `kind`, or `python` for a class from outside the package.

    Raises:
        ConfigError: if it is no mapping, `kind` is missing or unknown, or a setting of that kind is wrong.
    """
    if not isinstance(data, dict):
        raise ConfigError(f"{where}: expected a mapping with the key 'kind', {did_you_mean('', CONTROLLERS)}")
    try:
        with given_by(where):
            data = _read(data)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from None
    return _KINDS[data["kind"]].parse(data, where)


_SERVED = {
    "continuous": ("continuous", "intermittent", "none"),
    "intermittent": ("intermittent", "none"),
    "none": ("none",),
}


def sensor_fault(settings: AnyControllerSettings, kind: str) -> str:
    """Why a controller cannot work with a sensor of `kind`, empty where it can."""
    wanted, served = settings.resolved().estimator.sensor, _SERVED[kind]
    if wanted in served:
        return ""
    return f"estimator.sensor: got {wanted}, expected {' or '.join(served)}: the sensor is {kind}"


def told_of_sensor(block: Any, told: Mapping[str, Any]) -> Any:
    """The block of a controller with what its sensor says of itself, where the block does not say something else.

    Args:
        block: as it was given; what is no block of a known kind comes back as it is.
        told: keys of `estimator`; those that a controller of this kind does not know are left out.
    """
    if isinstance(block, AnyControllerSettings):
        block = {**block.model_dump(exclude_unset=True), "kind": block.kind}
    if not told or not isinstance(block, Mapping):
        return block
    try:
        data, own = _read(block), block.get("estimator", {})
        settings = PythonControllerSettings.named(data["python"]) if data["kind"] == "python" else _KINDS[data["kind"]]
    except (ConfigError, ValueError):  # the field itself says what is wrong
        return block
    if not isinstance(own, Mapping):
        return block
    known = type(settings.model_fields["estimator"].get_default()).model_fields
    return {**data, "estimator": {**{key: value for key, value in told.items() if key in known}, **own}}

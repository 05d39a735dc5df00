"""Registry of the kinds of controllers: those of the package by `kind`, external ones by `python`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NoReturn, get_args

from pydantic import BeforeValidator, ConfigDict, Field, PrivateAttr, ValidationError, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.from_outside import MEMORY, MODULE_AND_CLASS, class_named, given_by, is_reading, refusal, with_kind

from .estimation.observer import SensorKindSettings
from .feedback import InverseControllerSettings, InversePidControllerSettings, PidControllerSettings
from .law import LawSettings
from .mpc_settings import LinearisedMpcSettings, SamplingMpcSettings

GROUP = "hystmpc.controllers"
"""Entry points by which an installed package makes `kind: NAME` known; the value is MODULE:CLASS."""


class PythonControllerSettings(Settings):
    """External controller, `python: MODULE:CLASS`, whose settings class is derived from `LawSettings`.

    Attributes:
        kind: says which block this is; may be left out.
        python: module and class, such as `mylab.law:SlidingMode`, of an installed package or of the working folder.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow")  # the external class checks its keys itself

    kind: Literal["python"] = "python"
    python: str = Field(pattern=MODULE_AND_CLASS)
    _read_only: str = PrivateAttr("")  # why the class is not imported, for a reader of a folder

    @model_validator(mode="after")
    def _fits_its_class(self) -> PythonControllerSettings:
        self._read_only = refusal(self.python, GROUP) if is_reading() else ""
        try:
            self.resolved()
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return self

    def resolved(self) -> LawSettings:
        """Return the settings of the named class; if it is not imported, the keys that every controller has.

        Raises:
            ConfigError: if there is no such class, or a key does not fit it.
        """
        return self._resolved

    @cached_property
    def _resolved(self) -> LawSettings:
        if self._read_only:
            return _unread(self._read_only, dict(self.model_extra or {}))
        return self.named(self.python).parse(dict(self.model_extra or {}), f"controller {self.python}")

    @staticmethod
    def named(python: str) -> type[LawSettings]:
        """Import the class MODULE:CLASS.

        Raises:
            ConfigError: if there is none.
        """
        return class_named(python, "controller", GROUP, LawSettings)


class _Unread(LawSettings):
    """Settings of an external controller whose class a report does not import."""

    _why: str = PrivateAttr("")

    def observer(self, predictor: object) -> NoReturn:
        del predictor
        raise ConfigError(f"controller: {self._why}")

    def law(self, predictor: object, inverse: object, limits: object) -> NoReturn:
        del predictor, inverse, limits
        raise ConfigError(f"controller: {self._why}")


def _unread(why: str, given: dict[str, Any]) -> LawSettings:
    """Limits and sensor of an external controller whose class is not imported, where the file has these keys."""
    block = given.get("estimator")
    known = SensorKindSettings.model_fields
    estimator = {key: block[key] for key in known if key in block} if type(block) is dict else {}
    try:
        settings = _Unread.model_validate({"limits": given.get("limits"), "estimator": estimator})
    except ValidationError:  # a class may mean something else by these names
        settings = _Unread()
    settings._why = why
    return settings


# A new controller of the package is one class of settings, its law in `build.py`, and one line here; all that lists
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
    """Validate the settings of a controller: a mapping with the key `kind`, or `python` for an external class.

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
    """Return the reason why a controller cannot work with a sensor of `kind`; empty if it can."""
    wanted, served = settings.resolved().estimator.sensor, _SERVED[kind]
    if wanted in served:
        return ""
    return f"estimator.sensor: got {wanted}, expected {' or '.join(served)}: the sensor is {kind}"


def with_sensor_facts(block: Any, keys: Mapping[str, Any]) -> Any:
    """Complete a controller's block by the keys that follow from its sensor; keys in the block take precedence.

    Args:
        block: plain data; anything but a block of a known kind is returned unchanged.
        keys: keys of `estimator`; those unknown to a controller of this kind are left out.
    """
    if isinstance(block, AnyControllerSettings):
        block = {**block.model_dump(exclude_unset=True), "kind": block.kind}
    if not keys or not isinstance(block, Mapping):
        return block
    try:
        data, given = _read(block), block.get("estimator", {})
        settings = PythonControllerSettings.named(data["python"]) if data["kind"] == "python" else _KINDS[data["kind"]]
    except (ConfigError, ValueError):  # the field itself says what is wrong
        return block
    if not isinstance(given, Mapping):
        return block
    known = type(settings.model_fields["estimator"].get_default()).model_fields
    return {**data, "estimator": {**{key: value for key, value in keys.items() if key in known}, **given}}

"""Controllers from outside the package: settings of a class that a file names, or of an installed package."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, Literal, NoReturn

from pydantic import ConfigDict, Field, PrivateAttr, ValidationError, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.from_outside import MODULE_AND_CLASS, class_named, is_reading, refusal

from .estimation.observer import SensorKindSettings
from .law import LawSettings

GROUP = "hystmpc.controllers"
"""Entry points by which an installed package makes `kind: NAME` known; the value is MODULE:CLASS."""


class PythonControllerSettings(Settings):
    """`python: MODULE:CLASS`: settings of yours, derived from `LawSettings`; every further key is one of theirs.

    Attributes:
        kind: says which block this is; may be left out.
        python: module and class, such as `mylab.law:SlidingMode`, of an installed package or of the working folder.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow")

    kind: Literal["python"] = "python"
    python: str = Field(pattern=MODULE_AND_CLASS)
    _read_only: str = PrivateAttr("")  # why the class is not imported, for a reader of a folder

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        """Every key may be one of the class, which says what is wrong with it."""
        return data

    @model_validator(mode="after")
    def _fits_its_class(self) -> PythonControllerSettings:
        self._read_only = refusal(self.python, GROUP) if is_reading() else ""
        try:
            self.resolved()
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return self

    def resolved(self) -> LawSettings:
        """The settings that are meant; of a class that is not imported, what stands in the file for every controller.

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
        """The class MODULE:CLASS.

        Raises:
            ConfigError: if there is none.
        """
        return class_named(python, "controller", GROUP, LawSettings)  # type: ignore[type-abstract]


class _Unread(LawSettings):
    """What a report may know of a controller whose class it does not import."""

    _why: str = PrivateAttr("")

    def observer(self, predictor: object) -> NoReturn:
        del predictor
        raise ConfigError(f"controller: {self._why}")

    def law(self, predictor: object, inverse: object, limits: object) -> NoReturn:
        del predictor, inverse, limits
        raise ConfigError(f"controller: {self._why}")


def _unread(why: str, given: dict[str, Any]) -> LawSettings:
    """Limits and sensor of a controller, where the file says them in the words of the package."""
    told = given.get("estimator")
    estimator = {key: told[key] for key in SensorKindSettings.model_fields if key in told} if type(told) is dict else {}
    try:
        settings = _Unread.model_validate({"limits": given.get("limits"), "estimator": estimator})
    except ValidationError:  # a class may mean something else by these names
        settings = _Unread()
    settings._why = why
    return settings

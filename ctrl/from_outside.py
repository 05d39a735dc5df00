"""Controllers from outside the package: settings of a class that a file names, or of an installed package."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.from_outside import MODULE_AND_CLASS, class_named

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

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        """Every key may be one of the class, which says what is wrong with it."""
        return data

    @model_validator(mode="after")
    def _fits_its_class(self) -> PythonControllerSettings:
        try:
            self.resolved()
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return self

    def resolved(self) -> LawSettings:
        """The settings that are meant.

        Raises:
            ConfigError: if there is no such class, or a key does not fit it.
        """
        return self._resolved

    @cached_property
    def _resolved(self) -> LawSettings:
        return self.named(self.python).parse(dict(self.model_extra or {}), f"controller {self.python}")

    @staticmethod
    def named(python: str) -> type[LawSettings]:
        """The class MODULE:CLASS.

        Raises:
            ConfigError: if there is none.
        """
        return class_named(python, "controller", LawSettings)  # type: ignore[type-abstract]

"""Devices from outside the package: a class that a bench's file names, one of an installed package, or an instance."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field, PrivateAttr, model_validator

from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.from_outside import MODULE_AND_CLASS, class_named, working_folder

from .guarded import GuardedTransport, lacking, lacks
from .transport import RunContext, Transport, TransportBase

GROUP = "hystmpc.transports"
"""Entry points by which an installed package makes `kind: NAME` known; the value is MODULE:CLASS."""


class PythonSettings(TransportBase):
    """`python: MODULE:CLASS`: a class of yours; every further key is a keyword argument of it.

    Attributes:
        kind: says which block this is; may be left out.
        python: module and class, such as `mylab.bus:Bus`, of an installed package or of the working folder.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow")

    kind: Literal["python"] = "python"
    python: str = Field(pattern=MODULE_AND_CLASS)
    _instance: Transport | None = PrivateAttr(None)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        """Every key may be an argument; `open` knows which the class takes."""
        return data

    @classmethod
    def of(cls, transport: Transport) -> PythonSettings:
        """Of a transport that is there already."""
        settings = cls(python=f"{type(transport).__module__}:{type(transport).__name__}")
        settings._instance = transport
        return settings

    @property
    def place(self) -> str:
        return f"transport {self.python}"

    def open(self, run: RunContext) -> Transport:
        if self._instance is not None:
            instance = self._instance
            return GuardedTransport(lambda: instance, self.python, run)
        return GuardedTransport(self._make(), self.python, run)

    def _make(self) -> Callable[[], Any]:
        """Makes the transport; class, methods and arguments are checked already."""

        def made() -> Any:
            with working_folder():  # a class may import more when it is made
                return found(**arguments)

        found, arguments = class_named(self.python, "transport", GROUP, object), dict(self.model_extra or {})
        if missing := lacking(found):
            raise ConfigError(f"transport {self.python}: {lacks(missing)}")
        try:
            signature = inspect.signature(found)
        except ValueError:  # compiled, without one
            return made
        try:
            signature.bind(**arguments)
        except TypeError as error:
            expected = _expected(arguments, list(signature.parameters))
            raise ConfigError(f"transport {self.python}: {error}, {expected}") from None
        return made


def _expected(arguments: Mapping[str, Any], taken: list[str]) -> str:
    wrong = next((key for key in arguments if key not in taken), "")
    return did_you_mean(wrong, taken) if wrong else f"expected arguments: {', '.join(taken)}"

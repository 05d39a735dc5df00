"""Devices from outside the package: a class that a bench's file names, one of an installed package, or an instance."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field, PrivateAttr, model_validator

from hystmpc.trials.errors import ConfigError, did_you_mean

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
    python: str = Field(pattern=r"^\w+(\.\w+)*:\w+$")
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
        found, arguments = class_named(self.python), dict(self.model_extra or {})
        if missing := lacking(found):
            raise ConfigError(f"transport {self.python}: {lacks(missing)}")
        try:
            signature = inspect.signature(found)
        except ValueError:  # compiled, without one
            return lambda: found(**arguments)
        try:
            signature.bind(**arguments)
        except TypeError as error:
            expected = _expected(arguments, list(signature.parameters))
            raise ConfigError(f"transport {self.python}: {error}, {expected}") from None
        return lambda: found(**arguments)


def with_kind(known: Mapping[str, type[TransportBase]]) -> Callable[[Any], Any]:
    """Reads the block `transport`: fills in its kind where a class is named, and the class where an entry point is.

    Args:
        known: kinds of the package itself, which come before an entry point of the same name.
    """

    def read(data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        if "python" in data:
            return {"kind": "python", **data}
        kind = data.get("kind")
        if kind is None:
            raise ValueError(f"got neither kind nor python, expected kind: {', '.join(known)}, or python: MODULE:CLASS")
        if kind in known:
            return data
        installed = {entry.name: entry.value for entry in entry_points(group=GROUP)}
        if kind not in installed:
            raise ValueError(f"unknown kind {kind!r}, {did_you_mean(str(kind), [*known, *installed])}")
        return {**data, "kind": "python", "python": installed[kind].partition("[")[0].strip()}

    return read


def class_named(name: str) -> type:
    """The class MODULE:CLASS, of an installed package or of the working folder.

    Raises:
        ConfigError: if there is no such module or class, or the module cannot be imported.
    """
    module, _, attribute = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # last: a file of the working folder takes the place of no installed module
    try:
        found = import_module(module)
    except ModuleNotFoundError as error:
        missing = error.name or module
        if f"{module}.".startswith(f"{missing}."):
            raise ConfigError(
                f"transport {name}: no module {missing!r} is installed or in the working folder {here}"
            ) from None
        raise ConfigError(f"transport {name}: its module needs {missing!r}, which is not installed") from None
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a module of the lab's may raise anything
        text = " ".join(str(error).split())[:200]
        raise ConfigError(f"transport {name}: cannot be imported ({type(error).__name__}: {text})") from None
    kind = getattr(found, attribute, None)
    if not isinstance(kind, type):
        own = [key for key, value in vars(found).items() if isinstance(value, type) and value.__module__ == module]
        raise ConfigError(
            f"transport {name}: no class {attribute!r} in {found.__file__}, {did_you_mean(attribute, own)}"
        )
    return kind


def _expected(arguments: Mapping[str, Any], taken: list[str]) -> str:
    wrong = next((key for key in arguments if key not in taken), "")
    return did_you_mean(wrong, taken) if wrong else f"expected arguments: {', '.join(taken)}"

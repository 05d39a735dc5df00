"""Classes and objects from outside the package: MODULE:NAME in a file, or an installed package's entry point."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, TypeVar

from .errors import ConfigError, did_you_mean

T = TypeVar("T")

MODULE_AND_CLASS = r"^\w+(\.\w+)*:\w+$"
"""What `python: MODULE:CLASS` in a file has to look like."""


def installed(group: str) -> dict[str, str]:
    """MODULE:NAME by the name of each entry point that installed packages have in a group."""
    return {entry.name: entry.value.partition("[")[0].strip() for entry in entry_points(group=group)}


def object_named(name: str, what: str, fits: Callable[[Any], bool], wanted: str) -> Any:
    """The object MODULE:NAME, of an installed package or of the working folder.

    Args:
        name: module and name in it.
        what: the object's place in a sentence, such as `transport`.
        fits: whether a value of the module is of the right kind.
        wanted: that kind in a sentence, such as `class`.

    Raises:
        ConfigError: if there is no such module or object, the object is of another kind, or the module cannot be
            imported.
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
                f"{what} {name}: no module {missing!r} is installed or in the working folder {here}"
            ) from None
        raise ConfigError(f"{what} {name}: its module needs {missing!r}, which is not installed") from None
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a module of the lab's may raise anything
        text = " ".join(str(error).split())[:200]
        raise ConfigError(f"{what} {name}: cannot be imported ({type(error).__name__}: {text})") from None
    value = getattr(found, attribute, None)
    if not fits(value):
        fitting = {key: kept for key, kept in vars(found).items() if fits(kept) and not key.startswith("_")}
        own = [key for key, kept in fitting.items() if not isinstance(kept, type) or kept.__module__ == module]
        hint = did_you_mean(attribute, own)
        raise ConfigError(f"{what} {name}: no {wanted} {attribute!r} in {found.__file__}, {hint}")
    return value


def class_named(name: str, what: str, base: type[T]) -> type[T]:
    """The class MODULE:CLASS; errors as of `object_named`.

    Args:
        base: class that it has to derive from.
    """
    wanted = "class" if base is object else f"class derived from {base.__name__}"
    found: type[T] = object_named(name, what, lambda value: isinstance(value, type) and issubclass(value, base), wanted)
    return found


def installed_objects(group: str, what: str, kind: type[T], taken: Iterable[str]) -> dict[str, T]:
    """The instances of a class that installed packages have in a group, by their `name`.

    Args:
        group: of the entry points; the value of each is MODULE:NAME.
        what: their place in a sentence, such as `effect`.
        kind: class of the instances.
        taken: names of the package's own.

    Raises:
        ConfigError: if one cannot be imported, is of another class, or has a name that is taken.
    """
    found: dict[str, T] = {}
    for value in installed(group).values():
        made = object_named(value, what, lambda kept: isinstance(kept, kind), f"{kind.__name__} object")
        if made.name in found or made.name in taken:
            raise ConfigError(f"{what} {value}: got the name {made.name!r}, which is taken, expected another")
        found[made.name] = made
    return found


def with_kind(known: Iterable[str], group: str) -> Callable[[Any], Any]:
    """Reads a block with `kind: NAME` or `python: MODULE:CLASS`; the latter becomes `kind: python`.

    Args:
        known: kinds of the package itself, which come before an entry point of the same name.
        group: of the entry points that make further kinds known.
    """
    own = [kind for kind in known if kind != "python"]

    def read(data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        if "python" in data:
            return {"kind": "python", **data}
        kind = data.get("kind")
        if kind is None:
            raise ValueError(f"got neither kind nor python, expected kind: {', '.join(own)}, or python: MODULE:CLASS")
        if kind in own:
            return data
        others = installed(group)
        if kind not in others:
            raise ValueError(f"unknown kind {kind!r}, {did_you_mean(str(kind), [*own, *others])}")
        return {**data, "kind": "python", "python": others[kind]}

    return read

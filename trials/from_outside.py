"""Classes and objects from outside the package: MODULE:NAME in a file, or an installed package's entry point.

Only this module imports names given as text, after one security check. Allowed are entry points of installed packages,
names given by the calling program, and names that the user has confirmed; none while a folder is only read.
"""

from __future__ import annotations

import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from .errors import ConfigError, did_you_mean

T = TypeVar("T")

MODULE_AND_CLASS = r"^\w+(\.\w+)*:\w+$"
"""Pattern of `python: MODULE:CLASS` in a file."""

MEMORY = "<memory>"
"""Source of data given by the program itself."""

ALLOWED = "HYSTMPC_ALLOW_PYTHON"
"""Environment variable with each MODULE:CLASS that files may name, separated by spaces, or `all`."""

_ALL = "all"
_LONGEST_PLACE = 100  # characters of a file's name in a refusal
_by_code: ContextVar[bool | None] = ContextVar("by_code", default=None)  # of the data that are read; None outside
_reading: ContextVar[bool] = ContextVar("reading", default=False)


def allow_python(*names: str) -> None:
    """Allow this process, and those started later, to import classes given in files as `python: MODULE:CLASS`."""
    given = os.environ.get(ALLOWED, "").split()
    os.environ[ALLOWED] = " ".join(dict.fromkeys([*given, *(names or (_ALL,))]))


@contextmanager
def only_reads() -> Iterator[None]:
    """Context for reading a folder: no class named in it is imported, even if it is allowed."""
    token = _reading.set(True)
    try:
        yield
    finally:
        _reading.reset(token)


@contextmanager
def given_by(where: object) -> Iterator[None]:
    """Context for the validation of data, also nested, from `where`; `MEMORY` marks data of the program itself."""
    token = _by_code.set(where == MEMORY if _by_code.get() is None else _by_code.get())
    try:
        yield
    finally:
        _by_code.reset(token)


def is_reading() -> bool:
    """Whether the context `only_reads` is active."""
    return _reading.get()


def refusal(name: str, group: str) -> str:
    """Reason why MODULE:NAME may not be imported now; empty if it may."""
    if name in installed(group).values():
        return ""
    said = os.environ.get(ALLOWED, "").split()
    if not _reading.get() and (_ALL in said or name in said):
        return ""
    if _reading.get():
        return f"{name} is not imported: a report only reads"
    place = _place_of(name) or "a module that is not found"
    return f"{name} would run {place}, expected a yes if you trust it: --allow-python, in Python allow_python()"


def _place_of(name: str) -> str:
    """Path of the module of MODULE:NAME, without importing it; empty if there is none."""
    spec = None
    with working_folder(), suppress(ImportError, ValueError, OSError):
        spec = find_spec(name.partition(":")[0].partition(".")[0])
    if spec is None:
        return ""
    place = spec.origin or next(iter(spec.submodule_search_locations or ()), spec.name)
    return place if len(place) <= _LONGEST_PLACE else f"...{place[-_LONGEST_PLACE:]}"


@contextmanager
def working_folder() -> Iterator[None]:
    """Context of an import from the working folder, last on the import path to replace no installed module."""
    here = str(Path.cwd())
    if here in sys.path:
        yield
        return
    sys.path.append(here)
    try:
        yield
    finally:
        with suppress(ValueError):
            sys.path.remove(here)


def installed(group: str) -> dict[str, str]:
    """Entry points of installed packages in a group: MODULE:NAME by entry name."""
    return {entry.name: entry.value.partition("[")[0].strip() for entry in entry_points(group=group)}


def object_named(name: str, what: str, group: str, fits: Callable[[Any], bool], wanted: str) -> Any:
    """Import the object MODULE:NAME from an installed package or the working folder.

    Args:
        what: the object's role in a sentence, such as `transport`.
        fits: whether a value of the module is of the right kind.
        wanted: that kind in a sentence, such as `class`.

    Raises:
        ConfigError: if nobody has allowed it, there is no such module or object, the object is of another kind, or the
            module cannot be imported.
    """
    if refused := refusal(name, group):
        raise ConfigError(f"{what}: {refused}")
    module, _, attribute = name.partition(":")
    here = str(Path.cwd())
    try:
        with working_folder():
            loaded = import_module(module)
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
    value = getattr(loaded, attribute, None)
    if not fits(value):
        fitting = {key: kept for key, kept in vars(loaded).items() if fits(kept) and not key.startswith("_")}
        names = [key for key, kept in fitting.items() if not isinstance(kept, type) or kept.__module__ == module]
        hint = did_you_mean(attribute, names)
        raise ConfigError(f"{what} {name}: no {wanted} {attribute!r} in {loaded.__file__}, {hint}")
    return value


def class_named(name: str, what: str, group: str, base: type[T]) -> type[T]:
    """Import the class MODULE:CLASS; errors as of `object_named`."""
    wanted = "class" if base is object else f"class derived from {base.__name__}"

    def fits(value: Any) -> bool:
        return isinstance(value, type) and issubclass(value, base)

    kind: type[T] = object_named(name, what, group, fits, wanted)
    return kind


def made_by(kind: Callable[..., T], arguments: Mapping[str, Any], what: str) -> Callable[[], T]:
    """Factory of an instance of a user's class, after a check of its arguments.

    Args:
        what: the class in a sentence, such as `transport mylab:Bus`.

    Raises:
        ConfigError: if the arguments do not fit.
    """

    def made() -> T:
        with working_folder():  # a class may import more when it is made
            return kind(**arguments)

    try:
        signature = inspect.signature(kind)
    except ValueError:  # compiled, without one
        return made
    try:
        signature.bind(**arguments)
    except TypeError as error:
        taken = list(signature.parameters)
        wrong = next((key for key in arguments if key not in taken), "")
        expected = did_you_mean(wrong, taken) if wrong else f"expected arguments: {', '.join(taken)}"
        raise ConfigError(f"{what}: {error}, {expected}") from None
    return made


def installed_objects(group: str, what: str, kind: type[T], taken: Iterable[str]) -> dict[str, T]:
    """Instances of a class in an entry point group of installed packages, by their `name`.

    Args:
        group: of the entry points; the value of each is MODULE:NAME.
        taken: names already in use.

    Raises:
        ConfigError: if one cannot be imported, is of another class, or has a name that is taken.
    """
    objects: dict[str, T] = {}
    for value in installed(group).values():
        made = object_named(value, what, group, lambda kept: isinstance(kept, kind), f"{kind.__name__} object")
        if made.name in objects or made.name in taken:
            raise ConfigError(f"{what} {value}: got the name {made.name!r}, which is taken, expected another")
        objects[made.name] = made
    return objects


def hint_for(name: str, known: Iterable[str], of_laboratory: Iterable[str]) -> str:
    """Advice for an unknown name: how to install the laboratory if that has it, otherwise the nearest known name."""
    if name in of_laboratory:
        return "a part of the laboratory: pip install 'hystmpc[papers]'"
    return did_you_mean(name, known)


def with_kind(known: Iterable[str], group: str) -> Callable[[Any], Any]:
    """Validator of a block with `kind: NAME` or `python: MODULE:CLASS`; the latter becomes `kind: python`.

    Here a class that is not allowed is refused before any other work, unless a folder is only read. A missing class is
    refused at its import.

    Args:
        known: kinds of the package itself, which come before an entry point of the same name.
        group: entry point group of further kinds.
    """
    kinds = [kind for kind in known if kind != "python"]

    def read(data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        if "python" in data:
            _judge(data["python"], group)
            return {"kind": "python", **data}
        kind = data.get("kind")
        if kind is None:
            raise ValueError(f"got neither kind nor python, expected kind: {', '.join(kinds)}, or python: MODULE:CLASS")
        if kind in kinds:
            return data
        others = installed(group)
        if kind not in others:
            raise ValueError(f"unknown kind {kind!r}, {did_you_mean(str(kind), [*kinds, *others])}")
        return {**data, "kind": "python", "python": others[kind]}

    return read


def _judge(name: Any, group: str) -> None:
    """Refuse a class that may not be imported; allow one that the program itself names."""
    if not isinstance(name, str) or not re.match(MODULE_AND_CLASS, name) or _reading.get():
        return  # the field reports the error, or nothing is imported
    if refused := refusal(name, group):
        if _by_code.get():
            allow_python(name)
        elif _place_of(name):
            raise ValueError(refused)

"""The engine's shared library of this processor: found, checked against its C files, loaded, its functions bound.

The prototypes of the headers say which arguments a function takes: `const double *x` is a contiguous float64 array,
`int n` a whole number. Nothing else in Python knows C.
"""

from __future__ import annotations

import copyreg
import ctypes
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
from filelock import FileLock

from .build import build, digest, file_name, levels, sources

FOLDER = Path(__file__).resolve().parent
"""Place of the C files and of the libraries."""

_LONGEST = 240  # characters of a compiler's message


class EngineError(OSError):
    """Engine that is missing or of other C files, and cannot be compiled here; a fault of the installation."""


@cache
def engine(level: str | None = None) -> Any:
    """Functions of the engine by their names without `hystmpc_`; a call releases the interpreter's lock.

    A wheel brings the library. In a checkout it is compiled again where a C file has changed since.

    Args:
        level: of vector instructions, for tests; the best one of this processor where left out.

    Raises:
        EngineError: if the library is missing or older than the C files, and cannot be compiled.
    """
    return compiled(FOLDER, level)


@cache
def compiled(folder: Path, level: str | None = None) -> Any:
    """Functions of the C files in a folder; arguments and errors as those of `engine`."""
    here = level
    if here is None:
        best = int(_current(FOLDER, "plain").hystmpc_level())
        here = next(name for name in levels() if name == "plain" or int(name[1:]) <= best)
    return bound(_current(folder, here), folder, level)


def bound(library: ctypes.CDLL, folder: Path, level: str | None = None) -> Any:
    """Functions of a library whose prototypes stand in the headers of a folder, behind `HYSTMPC_API`."""
    functions = SimpleNamespace()
    pointer: Any = library._FuncPtr
    kind: Any = type("_Function", (_Interruptible, pointer), {"_flags_": pointer._flags_, "_restype_": ctypes.c_int})
    copyreg.pickle(kind, _by_name)
    for result, name, arguments in _prototypes(folder):
        function: Any = kind((name, library))
        function.argtypes = [_argument(words) for words in arguments]
        function.restype = None if result == "void" else ctypes.c_char_p if "*" in result else _NUMBERS[result]
        function.home = folder, level, name.removeprefix("hystmpc_")
        setattr(functions, function.home[2], function)
    return functions


def _by_name(function: Any) -> tuple[Any, ...]:
    """A function is copied by its name: where the copy is made, it has another address."""
    return _function, function.home


def _function(folder: Path, level: str | None, name: str) -> Any:
    return getattr(compiled(folder, level), name)


class _Interruptible:
    """A function whose call is ended by Ctrl-C as any other: ctypes makes an `ArgumentError` of a Ctrl-C that comes
    while an argument is converted, and a search that keeps its best on Ctrl-C would lose it."""

    def __call__(self, *arguments: Any) -> Any:
        try:
            return super().__call__(*arguments)  # type: ignore[misc]
        except ctypes.ArgumentError as error:
            if "KeyboardInterrupt" in str(error):
                raise KeyboardInterrupt from None
            raise


class HoldsAddresses:
    """Base of objects that hold addresses of their own memory: a copy is built anew from the same arguments."""

    _arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *arguments: Any, **by_name: Any) -> Self:
        new = super().__new__(cls)
        new._arguments = arguments, by_name
        return new

    def __reduce__(self) -> tuple[Any, ...]:
        return _built, (type(self), *self._arguments)


def _built(kind: type[Any], arguments: tuple[Any, ...], by_name: dict[str, Any]) -> Any:
    return kind(*arguments, **by_name)


class _Array:
    """Argument that points to the numbers of a contiguous array of one type; None is a null pointer."""

    kind: np.dtype[Any]

    @classmethod
    def from_param(cls, array: Any) -> Any:
        if array is None:
            return None
        if array.dtype is cls.kind:  # this way takes half the time of the next
            try:  # `suppress` takes as long as the rest
                return _NO_BYTES.from_buffer(array)
            except (TypeError, ValueError, BufferError):
                pass  # read-only, or not contiguous
        if array.dtype != cls.kind or not array.flags.c_contiguous:
            raise TypeError(f"got an array of {array.dtype} or not contiguous, expected contiguous {cls.kind}")
        return ctypes.c_void_p(array.ctypes.data)


_NO_BYTES = ctypes.c_char * 0


_NUMBERS = {
    "real": ctypes.c_double,
    "int": ctypes.c_int,
    "long": ctypes.c_long,
    "double": ctypes.c_double,
    "float": ctypes.c_float,
}
_ARRAYS = {
    name: type(f"_{name}", (_Array,), {"kind": np.dtype(kind)})
    for name, kind in {
        "real": np.float64,
        "double": np.float64,
        "float": np.float32,
        "int": np.intc,
        "char": np.uint8,
    }.items()
}
_PROTOTYPE = re.compile(r"^HYSTMPC_API ([\w ]+?\**) ?\**(\w+)\(([^)]*)\);", re.MULTILINE)


def _prototypes(folder: Path) -> Iterator[tuple[str, str, list[str]]]:
    """Result, name and arguments of every function that the headers offer."""
    for file in sources(folder):
        if file.suffix == ".h":
            text = re.sub(r"/\*.*?\*/", "", file.read_text(encoding="utf-8"), flags=re.DOTALL)
            for match in _PROTOTYPE.finditer(text):
                result = match[0].removeprefix("HYSTMPC_API ").split(match[2])[0].replace("const ", "").strip()
                arguments = [one.strip() for one in " ".join(match[3].split()).split(",")]
                yield result, match[2], [one for one in arguments if one != "void"]


def _argument(words: str) -> Any:
    kind = words.replace("const ", "").split()[0].rstrip("*")
    if "*" not in words and "[" not in words:
        return _NUMBERS[kind]
    return _ARRAYS.get(kind, ctypes.c_void_p)


def _current(folder: Path, level: str) -> ctypes.CDLL:
    path = folder / file_name(level)
    if not _fresh(path):
        _rebuild(path)
    if not _fresh(path):
        raise EngineError("got a compiled engine of other C files than those beside it; install the package again")
    return ctypes.CDLL(str(path))


def _fresh(path: Path) -> bool:
    """Whether the library is there and of the present C files; a stale one must not be loaded, it would stay."""
    return path.exists() and _digest(path.parent).encode() in path.read_bytes()


@cache
def _digest(folder: Path) -> str:
    return digest(folder)


def _rebuild(path: Path) -> None:
    folder = path.parent
    try:
        with FileLock(folder / ".building.lock"):
            if not _fresh(path):  # nobody else has compiled it meanwhile
                build(folder, folder)
    except (OSError, RuntimeError) as error:
        raise EngineError(f"the engine is not compiled, and cannot be: {str(error)[:_LONGEST]}") from None

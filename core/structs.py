"""Structs of the engine's headers as memory that Python fills: problems, laws, tables, and answers to read.

The declarations of the headers are the only text that says what a struct holds:

    law = struct("hystmpc_law", horizon=20, moves=20, tracking=np.ones(20))
    engine().law_bytes(law.address)
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any, final

import numpy as np

from .build import sources
from .library import FOLDER, HoldsAddresses

_NUMBERS: Mapping[str, Any] = MappingProxyType(
    {
        "real": ctypes.c_double,
        "hystmpc_real": ctypes.c_double,
        "double": ctypes.c_double,
        "float": ctypes.c_float,
        "int": ctypes.c_int,
        "char": ctypes.c_uint8,
        "uint8_t": ctypes.c_uint8,
        "int32_t": ctypes.c_int32,
        "uint32_t": ctypes.c_uint32,
        "int64_t": ctypes.c_int64,
        "uint64_t": ctypes.c_uint64,
    }
)

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_DEFINED = re.compile(r"^#define (\w+) (0x[0-9A-Fa-f]+|\d+)\s*$", re.MULTILINE)
_ENUM = re.compile(r"\benum\s*\w*\s*\{([^}(]*)\}")  # one made by macros is no name of Python's
_STRUCT = re.compile(r"typedef struct\s*(?:\w+\s*)?\{([^}]*)\}\s*(\w+);")
_FUNCTION = re.compile(r"(\w+) \(\*(\w+)\)\((.*)\)", re.DOTALL)
_PLAIN = re.compile(r"(\w+)\s*(.*)", re.DOTALL)
_NAME = re.compile(r"(\**)\s*(\w+)((?:\[[^\]]+\])*)")
_CHOICE = re.compile(r"([^?]+)\?([^:]+):(.+)")
_SKIPPED = re.compile(r"\b(?:const|volatile|struct)\b\s*")


@dataclass(frozen=True)
class Field:
    """One field of a struct.

    Attributes:
        name, kind: as in C; the kind without `const` and stars.
        stars: depth of the pointer, 0 for a value.
        dimensions: of an array, outermost first.
        arguments: of a pointer to a function, whose result is `kind`; None for others.
    """

    name: str
    kind: str
    stars: int = 0
    dimensions: tuple[int, ...] = ()
    arguments: tuple[Any, ...] | None = None


class Declarations:
    """Structs and whole constants that a C text declares; what Python does not ask for may be anything.

    Args:
        text: headers one after the other.

    Attributes:
        constants: enumerations, and macros that are whole numbers, by name.
    """

    def __init__(self, text: str) -> None:
        plain = _COMMENT.sub("", text)
        self.constants: Mapping[str, int] = MappingProxyType(_constants(plain))
        self._bodies = {name: body for body, name in _STRUCT.findall(plain)}
        self._fields: dict[str, tuple[Field, ...]] = {}
        self._layouts: dict[str, type[ctypes.Structure]] = {}

    def fields(self, name: str) -> tuple[Field, ...]:
        """Return the fields of a struct in their order.

        Raises:
            KeyError: if no such struct is declared.
        """
        if name not in self._fields:
            self._fields[name] = tuple(_fields(self._bodies[name], self.constants))
        return self._fields[name]

    def layout(self, name: str) -> type[ctypes.Structure]:
        """Return a struct as ctypes has it; pointers are addresses, pointers to functions can be called.

        Raises:
            KeyError: if no such struct is declared.
        """
        if name not in self._layouts:
            fields = [(field.name, self._type(field)) for field in self.fields(name)]
            self._layouts[name] = type(name, (ctypes.Structure,), {"_fields_": fields})
        return self._layouts[name]

    def _type(self, field: Field) -> Any:
        if field.arguments is not None:
            result = None if field.kind == "void" else _NUMBERS[field.kind]
            return ctypes.CFUNCTYPE(result, *field.arguments)
        kind = ctypes.c_void_p if field.stars else _NUMBERS.get(field.kind) or self.layout(field.kind)
        for dimension in reversed(field.dimensions):
            kind = kind * dimension
        return kind


def constants() -> Mapping[str, int]:
    """Return the enumerations of the engine's headers, and its macros that are whole numbers, by name."""
    return _core().constants


def layout(name: str) -> type[ctypes.Structure]:
    """Return a struct of the engine's headers as ctypes has it, to read answers.

    Raises:
        KeyError: if no such struct is declared.
    """
    return _core().layout(name)


def fields_of(name: str) -> tuple[Field, ...]:
    """Return the fields of a struct of the engine's headers in their order.

    Raises:
        KeyError: if no such struct is declared.
    """
    return _core().fields(name)


def struct(name: str, /, **fields: Any) -> Struct:
    """Return a struct of the engine's headers with these fields; arguments and errors as those of `Struct`."""
    return Struct(name, **fields)


@final
class Struct(HoldsAddresses):
    """A constant struct of the engine's headers and all that it points to.

    Args:
        name: of the struct.
        fields: by name; those left out, and None, are zero or null. Numbers and arrays are copied. A field that points
            to numbers takes an array-like; one that points to a struct, or holds one, takes a `Struct`; one that points
            to something else an object with an `address`; one that points to a function a callable.

    Attributes:
        name: of the struct.
        fields: what was given; arrays are contiguous, of the field's number, read-only.
        address: of the memory, which lives as long as this object.

    Raises:
        KeyError: if no such struct is declared.
        ValueError: if a field is unknown, or cannot hold what it is given.
    """

    def __init__(self, name: str, /, **fields: Any) -> None:
        known = {field.name: field for field in fields_of(name)}
        if unknown := sorted(set(fields) - set(known)):
            raise ValueError(f"{name} has no field {', '.join(unknown)}, expected some of {', '.join(known)}")
        self.name = name
        self._memory = layout(name)()
        self._alive: list[Any] = []
        self.fields: Mapping[str, Any] = MappingProxyType(
            {key: self._put(known[key], value) for key, value in fields.items() if value is not None}
        )
        self._arguments = (name,), dict(self.fields)
        self.address = ctypes.addressof(self._memory)

    def __repr__(self) -> str:
        return f"Struct({self.name}, {', '.join(self.fields)})"

    def _put(self, field: Field, value: Any) -> Any:
        """Write a field; returns what is kept of the value."""
        try:
            if field.arguments is not None:
                return self._put_function(field, value)
            if field.stars and field.dimensions:
                raise ValueError("expected no value: the engine fills it")
            if field.stars:
                return self._put_pointer(field, value)
            return self._put_value(field, value)
        except (TypeError, ValueError, AttributeError) as error:
            raise ValueError(f"{self.name}.{field.name}: {error}") from None

    def _put_function(self, field: Field, value: Callable[..., Any]) -> Any:
        function = type(getattr(self._memory, field.name))(value)
        setattr(self._memory, field.name, function)
        self._alive.append(function)
        return value

    def _put_pointer(self, field: Field, value: Any) -> Any:
        if field.kind in _NUMBERS:
            value = _read_only(value, field)
            address = value.ctypes.data
        else:
            if isinstance(value, Struct) and value.name != field.kind:
                raise ValueError(f"got a {value.name}, expected a {field.kind}")
            address = value.address
        setattr(self._memory, field.name, address)
        self._alive.append(value)
        return value

    def _put_value(self, field: Field, value: Any) -> Any:
        place = getattr(type(self._memory), field.name)
        if isinstance(value, Struct):
            if value.name != field.kind or field.dimensions:
                raise ValueError(f"got a {value.name}, expected {field.kind} {list(field.dimensions)}")
            ctypes.memmove(ctypes.addressof(self._memory) + place.offset, value.address, place.size)
            self._alive.append(value)
            return value
        if field.dimensions:
            value = _read_only(value, field)
            if value.shape != field.dimensions:
                raise ValueError(f"got shape {value.shape}, expected {field.dimensions}")
            ctypes.memmove(ctypes.addressof(self._memory) + place.offset, value.ctypes.data, place.size)
            return value
        value = float(value) if field.kind in ("real", "hystmpc_real", "double", "float") else int(value)
        setattr(self._memory, field.name, value)
        if isinstance(value, int) and getattr(self._memory, field.name) != value:
            raise ValueError(f"got {value}, expected a number that fits {field.kind}")
        return value


@cache
def _core() -> Declarations:
    return Declarations("\n".join(file.read_text(encoding="utf-8") for file in sources(FOLDER) if file.suffix == ".h"))


def _read_only(value: Any, field: Field) -> Any:
    array = np.array(value, dtype=_NUMBERS[field.kind], order="C")
    array.flags.writeable = False
    return array


def _constants(plain: str) -> dict[str, int]:
    """Values of the macros that are whole numbers, and of the enumerations, which count on from the last value."""
    known = {name: int(value, 0) for name, value in _DEFINED.findall(plain)}
    for body in _ENUM.findall(plain):
        value = -1
        for entry in filter(None, (part.strip() for part in body.split(","))):
            name, _, given = (part.strip() for part in entry.partition("="))
            value = _whole(given, known) if given else value + 1
            known[name] = value
    return known


def _whole(expression: str, known: Mapping[str, int]) -> int:
    """Value of a number, a name, a sum of them, or a choice `name ? value : value`."""
    if choice := _CHOICE.fullmatch(expression.strip()):
        return _whole(choice[2 if _whole(choice[1], known) else 3], known)
    parts = [part.strip() for part in expression.split("+")]
    return sum(known[part] if part in known else int(part, 0) for part in parts)


def _fields(body: str, known: Mapping[str, int]) -> Iterator[Field]:
    for words in filter(None, (" ".join(part.split()) for part in body.split(";"))):
        plain = _SKIPPED.sub("", words)
        if function := _FUNCTION.fullmatch(plain):
            arguments = tuple(_argument(one.strip()) for one in function[3].split(","))
            yield Field(function[2], function[1], 1, (), arguments)
            continue
        declared = _PLAIN.fullmatch(plain)
        assert declared is not None, words
        for stars, name, dimensions in _NAME.findall(declared[2]):
            sizes = tuple(_whole(size, known) for size in re.findall(r"\[([^\]]+)\]", dimensions))
            yield Field(name, declared[1], len(stars), sizes)


def _argument(words: str) -> Any:
    return ctypes.c_void_p if "*" in words else _NUMBERS[words.split()[0]]

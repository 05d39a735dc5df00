"""Conversion of the structs in a C header to ctypes structures, without a compiler."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Mapping
from typing import Any

_STRUCT = re.compile(r"typedef struct \{(.*?)\} (\w+);", re.DOTALL)
_FIELD = re.compile(r"^\s*(?:const |volatile )?(\w+) (.+);")
_TYPES: Mapping[str, Any] = {
    "int": ctypes.c_int,
    "float": ctypes.c_float,
    "double": ctypes.c_double,
    "uint8_t": ctypes.c_uint8,
    "int32_t": ctypes.c_int32,
    "uint32_t": ctypes.c_uint32,
    "int64_t": ctypes.c_int64,
}
_SIZE = re.compile(r"^#define (\w+) (\d+)(?![\w.])", re.MULTILINE)
_NAME = re.compile(r"(\w+)((?:\[[^\]]+\])*)")


def structs(header: str, sizes: Mapping[str, int], real: Any) -> Mapping[str, type[ctypes.Structure]]:
    """Return every struct of a header as a ctypes structure, by name.

    Args:
        header: text; its conditions are `#if NAME` and `#endif`, its fields of `hystmpc_real`, plain numbers and other
            structs; names of structs begin with `hystmpc_`.
        sizes: of the macros in conditions and dimensions that the header does not define as a number.
    """
    sizes = {**{name: int(size) for name, size in _SIZE.findall(header)}, **sizes}
    known: dict[str, Any] = {"hystmpc_real": real, **_TYPES}
    plain = "\n".join(_chosen(re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL), sizes))
    for body, name in _STRUCT.findall(plain):
        fields = [field for line in body.splitlines() for field in _fields(line, sizes, known)]
        known[name] = type(name, (ctypes.Structure,), {"_fields_": fields})
    return {name: kind for name, kind in known.items() if name.startswith("hystmpc_") and name != "hystmpc_real"}


def _chosen(text: str, sizes: Mapping[str, int]) -> Iterator[str]:
    """Lines of the header whose preprocessor conditions hold."""
    conditions: list[bool] = []
    for line in text.splitlines():
        words = line.split()
        if line.startswith("#if"):
            conditions.append(bool(sizes.get(words[1], 1)) if words[0] == "#if" else True)
        elif line.startswith("#endif"):
            conditions.pop()
        elif all(conditions):
            yield line


def _fields(line: str, sizes: Mapping[str, int], known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    matched = _FIELD.match(line)
    if matched is None:
        return
    for name, dimensions in _NAME.findall(matched[2]):
        kind = known[matched[1]]
        for dimension in reversed(re.findall(r"\[([^\]]+)\]", dimensions)):
            kind = kind * _size(dimension, sizes)
        yield name, kind


def _size(expression: str, sizes: Mapping[str, int]) -> int:
    """Value of an array dimension: a number, a macro, or a sum of them."""
    return sum(int(part) if part.isdigit() else sizes[part] for part in expression.replace(" ", "").split("+"))

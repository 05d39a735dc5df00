"""Settings explained: every key with type, default, unit, bounds and meaning, and a JSON schema for editors.

The meanings are the `Attributes:` of the classes' docstrings, the rest is what pydantic checks. So neither a page nor a
schema can differ from what is read.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, TypeAdapter
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from hystmpc.trials.config import Settings

_SECTION = re.compile(r"^Attributes:\n((?:[ ]{4}.*\n?|\n(?=[ ]{4}))+)", re.MULTILINE)
_ENTRY = re.compile(r"^ {4}(\w+(?:, \w+)*): (.*(?:\n {5,}.*)*)", re.MULTILINE)
_BRACKETS = re.compile(r"\s*\[([^\]]+)\]")
_WORDS = {float: "number", int: "whole number", str: "text", bool: "true or false", Path: "file", Any: "anything"}
# Endings of keys, the longest first, and the unit that each says.
_ENDINGS = {
    "deg_per_sqrt_unit": "deg/sqrt(command unit)",
    "deg_per_sqrt_s": "deg/sqrt(s)",
    "per_deg_s": "command unit/(deg s)",
    "s_per_deg": "command unit s/deg",
    "deg_s3": "deg/s^3",
    "deg_s2": "deg/s^2",
    "deg_s": "deg/s",
    "per_deg": "command unit/deg",
    "per_s3": "command unit/s^3",
    "per_s2": "command unit/s^2",
    "per_s": "command unit/s",
    "deg": "deg",
    "hz": "Hz",
    "ms": "ms",
    "s": "s",
}
_BOUNDS = {
    "ge": "at least {}",
    "gt": "above {}",
    "le": "at most {}",
    "lt": "below {}",
    "multiple_of": "multiple of {}",
    "min_length": "at least {} long",
    "max_length": "at most {} long",
}


@dataclass(frozen=True)
class Key:
    """One key of a block of settings.

    Attributes:
        name: as it stands in the file.
        accepts: what the value may be, in words.
        default: as YAML writes it; None where the key has to be given.
        unit: of the value; empty for none.
        bounds: of the value, in words; empty for none.
        meaning: a line.
        blocks: the classes of settings that the value may be, or may hold.
    """

    name: str
    accepts: str
    default: str | None
    unit: str
    bounds: str
    meaning: str
    blocks: tuple[type[Settings], ...]


def keys_of(kind: type[Settings]) -> tuple[Key, ...]:
    """Every key of a block, in the order of the class; keys that only tell kinds apart first."""
    meanings = meanings_of(kind)
    keys = [_key(name, field, meanings.get(name, "")) for name, field in kind.model_fields.items()]
    return tuple(sorted(keys, key=lambda key: not key.meaning.startswith(_TELLS)))


def summary_of(kind: type[Settings]) -> str:
    """What the block is: its docstring before `Attributes:`."""
    return (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " ")


def meanings_of(kind: type[Settings]) -> Mapping[str, str]:
    """Meaning of each key by name: the entries of `Attributes:` of the class, then of its bases."""
    meanings: dict[str, str] = {}
    for base in kind.__mro__:
        section = _SECTION.search(inspect.cleandoc(base.__dict__.get("__doc__") or "") + "\n")
        for entry in _ENTRY.finditer(section[1] if section else ""):
            for name in entry[1].split(", "):
                meanings.setdefault(name, " ".join(entry[2].split()))
    return meanings


def blocks_in(annotation: Any) -> Iterator[type[Settings]]:
    """The classes of settings in an annotation, those in containers and unions included."""
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        yield annotation
    for part in get_args(annotation):
        yield from blocks_in(part)


def reachable(annotation: Any) -> tuple[type[Settings], ...]:
    """All blocks that can stand in a file, each once, outer ones first."""
    blocks: dict[type[Settings], None] = {}
    waiting = list(blocks_in(annotation))
    while waiting:
        block = waiting.pop(0)
        if block not in blocks:
            blocks[block] = None
            waiting = [*(b for field in block.model_fields.values() for b in blocks_in(field.annotation)), *waiting]
    return tuple(blocks)


def json_schema(annotation: Any, title: str) -> dict[str, Any]:
    """A JSON schema (draft 2020-12) of a file, with the meaning of every key as its description.

    Args:
        annotation: a class of settings, or a union of such.
        title: of the schema.
    """
    schema: dict[str, Any] = TypeAdapter(annotation).json_schema()
    bodies: dict[str, Any] = schema.get("$defs", {})
    for block in reachable(annotation):
        long = f"{block.__module__}.{block.__qualname__}".replace(".", "__")  # pydantic's, where a name stands for two
        body = bodies.get(block.__name__) or bodies.get(long) or schema
        mapping = next(part for part in (body, *body.get("anyOf", ())) if "properties" in part)
        mapping["description"] = summary_of(block)
        for key in keys_of(block):
            mapping["properties"][key.name]["description"] = key.meaning
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": title}


_TELLS = "says which block this is"


def _key(name: str, field: FieldInfo, meaning: str) -> Key:
    unit = _BRACKETS.search(meaning)
    discriminates = get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1
    numbers = bool({int, float} & set(_leaves(field.annotation)))
    return Key(
        name,
        _type(field.annotation),
        _default(field),
        unit[1] if unit else _unit_of(name) if numbers else "",
        ", ".join(dict.fromkeys(_bounds(field.metadata, field.annotation))),
        meaning or (_TELLS + "." if discriminates else ""),
        tuple(dict.fromkeys(blocks_in(field.annotation))),
    )


def _unit_of(name: str) -> str:
    return next((unit for ending, unit in _ENDINGS.items() if f"_{name}".endswith(f"_{ending}")), "")


def _default(field: FieldInfo) -> str | None:
    value = field.get_default(call_default_factory=True)
    return None if value is PydanticUndefined else _yaml(value)


def _yaml(value: Any) -> str:
    """A default on one line; of a block only what tells its kind."""
    if isinstance(value, BaseModel):
        kind = getattr(value, "kind", None)
        return "its own defaults" if kind is None else f"{{kind: {kind}}}"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {_yaml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_yaml, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _type(annotation: Any) -> str:
    """An annotation in words."""
    origin, of = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type(of[0])
    if origin is Literal:
        return " or ".join(f"`{value}`" for value in of)
    if origin in (Union, UnionType):
        words = [_type(part) for part in of if part is not NoneType]
        return " or ".join(dict.fromkeys([*words, *(["null"] if NoneType in of else [])]))
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        return "block"
    if annotation in _WORDS:
        return _WORDS[annotation]
    return _container(origin or annotation, of)


def _container(origin: Any, of: tuple[Any, ...]) -> str:
    if not isinstance(origin, type):
        return "anything"
    if issubclass(origin, Mapping):
        return f"mapping of name to {_type(of[1])}" if of else "mapping"
    if not issubclass(origin, Sequence):
        return "anything"
    several = of and of[-1] is not Ellipsis
    return f"list of {', '.join(_type(part) for part in (of if several else of[:1]))}"


def _leaves(annotation: Any) -> Iterator[Any]:
    parts = [part for part in get_args(annotation) if not isinstance(part, FieldInfo)]
    if get_origin(annotation) is Literal:
        return
    if not parts:
        yield annotation
    for part in parts:
        yield from _leaves(part)


def _bounds(metadata: Any, annotation: Any) -> Iterator[str]:
    """Bounds in words, those of the value before those of what it holds; names have none worth telling."""
    for entry in metadata:
        if isinstance(entry, FieldInfo):
            yield from _bounds(entry.metadata, None)
        for name, words in _BOUNDS.items():
            value = getattr(entry, name, None)
            if value is not None:
                yield words.format(f"{value:g}" if isinstance(value, float) else value)
    origin, of = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        yield from _bounds(of[1:], of[0])
    elif origin is not Literal:
        named = isinstance(origin, type) and issubclass(origin, Mapping)
        for part in of[1:] if named else of:
            yield from _bounds((), part)

"""Keys of settings in words: type, default, unit, bounds and meaning of each.

Type and bounds are read from the JSON schema of pydantic, meanings from the classes' docstrings.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

from pydantic import BaseModel, TypeAdapter

from hystmpc.cli.reference import TELLS, blocks_in, mapping_in, meanings_of
from hystmpc.trials.config import Settings

_BRACKETS = re.compile(r"\s*\[([^\]]+)\]")
_WORDS = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false", "null": "null"}
_BOUNDS = {
    "minimum": "at least {}",
    "exclusiveMinimum": "above {}",
    "maximum": "at most {}",
    "exclusiveMaximum": "below {}",
    "multipleOf": "multiple of {}",
    "minLength": "at least {} long",
    "minItems": "at least {} long",
    "minProperties": "at least {} long",
    "maxLength": "at most {} long",
    "maxItems": "at most {} long",
}
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
    schema = TypeAdapter(kind).json_schema()
    bodies = schema.get("$defs", {})
    body = mapping_in(bodies[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema)
    meanings = meanings_of(kind)
    keys = [_key(kind, name, body["properties"][name], meanings.get(name, "")) for name in kind.model_fields]
    return tuple(sorted(keys, key=lambda key: not key.meaning.startswith(TELLS)))


def _key(kind: type[Settings], name: str, schema: Mapping[str, Any], meaning: str) -> Key:
    field = kind.model_fields[name]
    unit = _BRACKETS.search(meaning)
    implied = next((unit for ending, unit in _ENDINGS.items() if f"_{name}".endswith(f"_{ending}")), "")
    numbers = any(part.get("type") in ("number", "integer") for part in _leaves(schema))
    return Key(
        name,
        _words(schema),
        None if field.is_required() else _yaml(field.get_default(call_default_factory=True)),
        unit[1] if unit else implied if numbers else "",
        ", ".join(dict.fromkeys(_bounds(schema))),
        meaning or (TELLS if "const" in schema else ""),
        tuple(dict.fromkeys(blocks_in(field.annotation))),
    )


def _yaml(value: Any) -> str:
    """A default on one line; of a block only what tells its kind."""
    if isinstance(value, BaseModel):
        kind = getattr(value, "kind", None)
        return "its own defaults" if kind is None else f"{{kind: {kind}}}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {_yaml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_yaml, value)) + "]"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _parts(schema: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Schemas of the alternatives and of the entries of a value."""
    inner = [schema.get("items"), schema.get("additionalProperties"), *schema.get("patternProperties", {}).values()]
    several = (schema.get(name, ()) for name in ("anyOf", "oneOf", "prefixItems"))
    return [*chain(*several), *({} if part is True else part for part in inner if part not in (None, False))]


def _leaves(schema: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    yield schema
    for part in _parts(schema):
        yield from _leaves(part)


def _words(schema: Mapping[str, Any]) -> str:
    """A schema in words."""
    if "const" in schema or "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema.get("enum", [schema.get("const")]))
    if "$ref" in schema:
        return "block"
    inner = [_words(part) for part in _parts(schema)]
    if "anyOf" in schema or "oneOf" in schema:
        return " or ".join(sorted(dict.fromkeys(inner), key=lambda word: word == "null"))
    if schema.get("type") == "array":
        return f"list of {', '.join(inner) or 'anything'}"
    if schema.get("type") == "object":
        return f"mapping of name to {', '.join(inner)}" if inner else "mapping"
    return "file" if schema.get("format") == "path" else _WORDS.get(schema.get("type", ""), "anything")


def _bounds(schema: Mapping[str, Any]) -> Iterator[str]:
    """Bounds in words, those of the value before those of what it holds."""
    for name, words in _BOUNDS.items():
        if name in schema and not (name.endswith("Items") and "prefixItems" in schema):
            value = schema[name]
            yield words.format(f"{value:g}" if isinstance(value, float) else value)
    for part in _parts(schema):
        yield from _bounds(part)

"""Reference of files and classes: `schema` and the keys of the settings, `effects`, `new`.

The meanings of keys are the `Attributes:` of the classes' docstrings, the rest is the JSON schema of pydantic: neither
a page nor a schema can differ from what is read.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from hystmpc.trials.errors import ConfigError, did_you_mean

from .console import line, out
from .verb import entries_of

if TYPE_CHECKING:
    from hystmpc.trials.config import Settings

FILES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "simulate": ("hystmpc.sim.config:SimulationConfig", "a study of `hystmpc simulate`"),
        "sweep": ("hystmpc.sim.sweep.settings:SweepSettings", "many studies, of `hystmpc simulate --sweep`"),
        "tune": ("hystmpc.sim.tuning.settings:TuneSettings", "a search of `hystmpc tune`"),
        "tip": ("hystmpc.ctrl.planner.settings:TipSettings", "a `TipController`"),
        "controller": ("hystmpc.ctrl.config:ControllerSettings", "one controller, of `hystmpc simulate --controller`"),
        "run": ("hystmpc.rig.config:RunSettings", "an experiment of `hystmpc run`"),
        "record": ("hystmpc.rig.config:RecordSettings", "recordings of `hystmpc record`"),
        "commission": ("hystmpc.bench.config:CommissionSettings", "a device of `hystmpc commission`"),
        "investigate": ("hystmpc.bench.config:InvestigateSettings", "a device of `hystmpc investigate`"),
        "device": ("hystmpc.rig.device:DeviceSettings", "a simulated device of `hystmpc device`"),
        "layout": ("hystmpc.trials.layouts:LogMapping", "a layout of logs, of `--layout FILE.yaml`"),
        "simulator": ("hystmpc.models.simulator:SimulatorFile", "a simulator that `hystmpc fit` writes"),
    }
)
"""Kinds of file: where their settings are defined, and what the file is."""

_BRACKETS = re.compile(r"\s*\[([^\]]+)\]")
_TELLS = "says which block this is"
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


def schema(
    kind: Annotated[str | None, typer.Argument(help="Kind of file; left out, the kinds are listed.")] = None,
) -> None:
    """An editor checks and completes a file whose schema it knows."""
    if kind is not None:
        typer.echo(json.dumps(json_schema(settings_of(kind), f"hystmpc: {FILES[kind][1]}"), indent=1))
        return
    for name, (_, what) in FILES.items():
        line(f"{name:12} {what}")


def effects(
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder for a picture of each effect and one HTML page; new or empty.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the library as JSON.")] = False,
) -> None:
    """Equation, parameters, units, bounds, sides."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from hystmpc.models.effects.catalogue import EFFECTS
    from hystmpc.models.effects.place import library_data, parameter_lines
    from hystmpc.trials.run_folder import require_vacant

    if folder is not None:
        from hystmpc.models.effects.pictures import write_pictures

        require_vacant(folder)
        page = write_pictures(folder)
        if not as_json:
            line(f"pictures and page: {page}")
    if as_json:
        typer.echo(json.dumps(library_data(), indent=1))
    elif folder is None:
        grid = Table(box=SIMPLE_HEAD, pad_edge=False)
        grid.add_column("effect and sides", no_wrap=True)
        grid.add_column("equation; parameters with unit, bounds, neutral value", overflow="fold")
        for effect in EFFECTS.values():
            lines = "\n".join((effect.equation, *(f"  {text}" for text in parameter_lines(effect))))
            grid.add_row(f"{effect.name}\n  {', '.join(effect.sides)}", lines, end_section=True)
        out.print(grid)


def new(
    kind: Annotated[str, typer.Argument(help="Kind of class: transport, effect or controller.")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder.")],
) -> None:
    """The contract tests pass as they are; a file to try the class with lies beside them."""
    from hystmpc.testing.templates import write_template

    for file in write_template(kind, folder):
        line(str(file))
    line(f"next: cd {folder} && pytest")


def settings_of(kind: str) -> Any:
    """Class of settings, or union of such classes, of a kind of file.

    Raises:
        ConfigError: if there is no such kind; names the nearest.
    """
    if kind not in FILES:
        raise ConfigError(f"schema {kind}: unknown kind of file, {did_you_mean(kind, FILES)}")
    module, name = FILES[kind][0].split(":")
    return getattr(import_module(module), name)


def json_schema(annotation: Any, title: str) -> dict[str, Any]:
    """A JSON schema (draft 2020-12) of a file, with the meaning of every key as its description.

    Args:
        annotation: a class of settings, or a union of such classes.
        title: of the schema.
    """
    from pydantic import TypeAdapter

    schema: dict[str, Any] = TypeAdapter(annotation).json_schema()
    bodies: dict[str, Any] = schema.get("$defs", {})
    for block in reachable(annotation):
        long = f"{block.__module__}.{block.__qualname__}".replace(".", "__")  # pydantic's, where a name stands for two
        body = _mapping(bodies.get(block.__name__) or bodies.get(long) or schema)
        body["description"] = summary_of(block)
        for key in keys_of(block):
            body["properties"][key.name]["description"] = key.meaning
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": title}


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
    from pydantic import TypeAdapter

    schema = TypeAdapter(kind).json_schema()
    bodies = schema.get("$defs", {})
    body = _mapping(bodies[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema)
    meanings = meanings_of(kind)
    keys = [_key(kind, name, body["properties"][name], meanings.get(name, "")) for name in kind.model_fields]
    return tuple(sorted(keys, key=lambda key: not key.meaning.startswith(_TELLS)))


def _mapping(body: dict[str, Any]) -> dict[str, Any]:
    """The part of a schema that describes a mapping of keys."""
    return next(part for part in (body, *body.get("anyOf", ())) if "properties" in part)


def summary_of(kind: type[Settings]) -> str:
    """What the block is: its docstring before `Attributes:`."""
    return (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " ")


def meanings_of(kind: type[Settings]) -> Mapping[str, str]:
    """Meaning of each key by name: the entries of `Attributes:` of the class, then of its bases."""
    bases = reversed(kind.__mro__)
    return {name: text for base in bases for name, text in entries_of(base.__doc__, "Attributes").items()}


def blocks_in(annotation: Any) -> Iterator[type[Settings]]:
    """The classes of settings in an annotation, those in containers and unions included."""
    from hystmpc.trials.config import Settings

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
        meaning or (f"{_TELLS}." if "const" in schema else ""),
        tuple(dict.fromkeys(blocks_in(field.annotation))),
    )


def _yaml(value: Any) -> str:
    """A default on one line; of a block only what tells its kind."""
    from pydantic import BaseModel

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

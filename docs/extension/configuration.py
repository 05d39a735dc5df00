"""Every key of every configuration file, from the classes that read them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from typing import Literal, get_args, get_origin

from hystmpc.cli.reference import FILES, reachable, settings_of, summary_of
from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.trials.config import Settings

from .keys import Key, keys_of
from .tables import anchor, sentence, table

Block = type[Settings]


def text() -> str:
    """A section for each kind of file, then one for each block that stands in one."""
    tops = {kind: _members(settings_of(kind)) for kind in FILES}
    places = _places(tops)
    parts = ["## Files"]
    for kind, members in tops.items():
        parts += [
            anchor(f"file-{kind}"),
            f"### `{kind}`",
            sentence(FILES[kind][1]),
            f"Schema: `hystmpc schema {kind}`.",
        ]
        parts += [_keys(members[0])] if len(members) == 1 else [f"One of {_links(members)}."]
    parts.append("## Blocks")
    for block in places:
        if block not in _files():
            stands = f"Stands in: {', '.join(dict.fromkeys(places[block]))}."
            parts += [anchor(_name(block)), f"### {_title(block, places)}", _summary(block), stands, _keys(block)]
    return "\n\n".join(parts)


def metadata() -> str:
    """The entries of a model file, `hystmpc.NAME`, whose values are JSON."""
    rows = [(f"`hystmpc.{key.name}`", _value(key), key.meaning) for key in keys_of(ModelMetadata)]
    return table(("entry", "value", "meaning"), rows)


def _members(annotation: object) -> tuple[Block, ...]:
    """The blocks that a file may be."""
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        return (annotation,)
    return tuple(dict.fromkeys(_flat(annotation)))


def _flat(annotation: object) -> Iterator[Block]:
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        yield annotation
    for part in get_args(annotation):
        yield from _flat(part)


@cache
def _files() -> dict[Block, str]:
    """Blocks that are whole files, and the kind of each."""
    settings = {kind: _members(settings_of(kind)) for kind in FILES}
    return {members[0]: kind for kind, members in settings.items() if len(members) == 1}


def _places(tops: dict[str, tuple[Block, ...]]) -> dict[Block, list[str]]:
    """Every block, and the keys that lead to it, each with a link to its owner."""
    found: dict[Block, list[str]] = {}
    for kind, members in tops.items():
        if len(members) > 1:
            for block in members:
                found.setdefault(block, []).append(f"file [`{kind}`](#file-{kind})")
        for block in reachable(settings_of(kind)):
            found.setdefault(block, [])
            owner = _links((block,))
            for key in keys_of(block):
                for inner in key.blocks:
                    found.setdefault(inner, []).append(f"`{key.name}` of {owner}")
    return found


def _short(block: Block) -> str:
    """The file that it is, the kind that the block says it is, or the name of its class."""
    return _files().get(block) or _tag(block) or block.__name__.removesuffix("Settings").removesuffix("Block")


def _tag(block: Block) -> str:
    for name, field in block.model_fields.items():
        if get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1:
            return f"{name}: {get_args(field.annotation)[0]}"
    return ""


def _title(block: Block, places: dict[Block, list[str]]) -> str:
    """The block as a file shows it: its key, and its kind where several share the key."""
    key = places[block][0].split("`")[1]
    return f"`{key}`" + (f", `{_tag(block)}`" if _tag(block) else "")


def _name(block: Block) -> str:
    """The name of the block's section in links."""
    if block in _files():
        return f"file-{_files()[block]}"
    room, name = block.__module__.split(".")[1], block.__name__
    return f"block-{room}-{name.removesuffix('Settings').lower()}"


def _links(blocks: Iterable[Block]) -> str:
    return ", ".join(f"[`{_short(block)}`](#{_name(block)})" for block in blocks)


def _summary(block: Block) -> str:
    """What the block is; its title has told the key and the kind."""
    return sentence(summary_of(block))


def _keys(block: Block) -> str:
    return table(("key", "value", "left out", "meaning"), [_row(key) for key in keys_of(block)])


def _row(key: Key) -> tuple[str, ...]:
    more = f" {_links(key.blocks)}" if key.blocks else ""
    left_out = "required" if key.default is None else f"`{key.default}`"
    return f"`{key.name}`", _value(key) + more, left_out, key.meaning


def _value(key: Key) -> str:
    kind = f"{key.accepts} [{key.unit}]" if key.unit else key.accepts
    return f"{kind}, {key.bounds}" if key.bounds else kind

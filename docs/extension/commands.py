"""Every verb of the command line, from the parser itself."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import typer

from hystmpc.cli.main import app

from .tables import anchor, sentence, table

_RECORD = re.compile(r"(?P<name>.+?)(?: <(?P<value>.+)>| (?P<capitals>[A-Z ]+))?")
_ENDING = re.compile(r"(?P<text>.*?)(?:  \[(?P<ending>[^\[\]]*)\])?")
_LIST = re.compile(r"list\[(.+)\]")
_WORDS = {
    "str": "text",
    "int range": "whole number",
    "int": "whole number",
    "float range": "number",
    "float": "number",
    "Path": "path",
}


def text() -> str:
    """A section for each verb with usage, arguments and options."""
    program = typer.main.get_command(app)
    context = program.make_context("hystmpc", [], resilient_parsing=True)
    return "\n\n".join(part for name in program.list_commands(context) for part in _verb(program, context, name, 2))


def _verb(group: Any, context: Any, name: str, level: int) -> Iterator[str]:
    command = group.get_command(context, name)
    inner = typer.Context(command, info_name=name, parent=context)
    yield anchor(inner.command_path.replace(" ", "-"))
    yield f"{'#' * level} `{inner.command_path}`"
    yield inspect.cleandoc(command.help or "")
    if hasattr(command, "list_commands"):
        for below in command.list_commands(inner):
            yield from _verb(command, inner, below, level + 1)
        return
    yield f"```text\n{inner.command_path} {' '.join(command.collect_usage_pieces(inner))}\n```"
    rows = [_row(*parameter.get_help_record(inner)) for parameter in command.params]
    if rows:
        yield table(("argument or option", "value", "meaning", "left out and bounds"), rows)


def _row(record: str, text: str) -> tuple[str, str, str, str]:
    """One argument or option; its record has the value in `<>` or capitals, its text ends with `[default; bounds]`."""
    found = _RECORD.fullmatch(record)
    name, value = (found["name"], found["value"] or found["capitals"] or "") if found else (record, "")
    meaning = _ENDING.fullmatch(text)
    said, ending = (meaning["text"], meaning["ending"] or "") if meaning else (text, "")
    for word, plain in _WORDS.items():
        value = re.sub(rf"\b{word}\b", plain, value)
    repeated = _LIST.fullmatch(value)
    value = f"{repeated[1]}, repeatable" if repeated else value.replace("|", " or ")
    return f"`{name}`", value, sentence(said), ending

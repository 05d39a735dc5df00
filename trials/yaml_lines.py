"""Where in a YAML file a setting stands, for error messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import yaml

from .yaml_ import YamlError, compose_yaml

Location = Sequence[str | int]


class MisplacedError(ValueError):
    """What a validator raises where it knows the offending entry within its own block.

    Args:
        message: one line.
        at: keys and indices from the validated block to the entry.
    """

    def __init__(self, message: str, at: Location = ()) -> None:
        super().__init__(message)
        self.at = tuple(at)


def line_of(text: str, at: Location) -> int | None:
    """Line, from 1, of the entry at keys and indices `at`, or of the innermost block around it that is there.

    Entries of `at` that are no key of the file (a validator's own marks) are passed over. None if the text is no YAML
    or nothing of `at` is there.
    """
    try:
        node = compose_yaml(text)
    except YamlError:
        return None
    line = None
    for part in at:
        found = _entry(node, part)
        if found is not None:
            line, node = found
    return line


def place_in(path: Path | str, overrides: Sequence[str] = ()) -> Callable[[Location], str]:
    """A function that says where an entry stands: `file.yaml, line 3`, or the override that set it.

    Args:
        path: a YAML file; read again only when a place is asked for.
        overrides: `a.b=3` changes that were applied to it.
    """

    def place(at: Location) -> str:
        parts = [str(part) for part in at]
        for text in reversed(overrides):
            changed = text.partition("=")[0].split(".")
            if parts[: len(changed)] == changed:
                return f"{path}, --set {text}"
        try:
            line = line_of(Path(path).read_text(encoding="utf-8"), at)
        except (OSError, UnicodeDecodeError):
            line = None
        return str(path) if line is None else f"{path}, line {line}"

    return place


def _entry(node: yaml.Node | None, part: str | int) -> tuple[int, yaml.Node] | None:
    """Line and value of one entry of a block."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value == str(part):
                return key.start_mark.line + 1, value
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and 0 <= part < len(node.value):
        item = node.value[part]
        return item.start_mark.line + 1, item
    return None

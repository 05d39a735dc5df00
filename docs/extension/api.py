"""The public names, from their docstrings: `import hystmpc` first, then the rooms."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from typing import Any

from hystmpc.trials.config import Settings

from .tables import anchor

MODULES = (
    "hystmpc",
    *(f"hystmpc.{room}" for room in ("trials", "models", "trajectories", "ctrl", "sim", "rig", "codegen", "testing")),
    "hystmpc_lab",
)

_CODE = 4  # columns from which on a line is code
_MARKUP = re.compile(r"\|[^|`]*\||(?<=\w)_(?=[\s.,;:)\]]|$)|\*(?=\.\w)")


def text() -> str:
    """A section for the front door, for each room with public names, and for the laboratory."""
    return "\n\n".join(part for name in MODULES for part in _module(name))


def _module(name: str) -> Iterator[str]:
    module = import_module(name)
    names = getattr(module, "__all__", None) or dir(module)
    yield anchor(f"api-{name.replace('.', '-')}")
    yield f"## `{name}`"
    yield (inspect.getdoc(module) or "").partition("\n\n")[0]
    front = dir(import_module("hystmpc"))
    for public in sorted((n for n in names if not n.startswith("__")), key=str.lower):
        if name != "hystmpc" and public in front:
            continue  # it stands there
        yield f"### `{public}`"
        yield f"```{{eval-rst}}\n{_directive(f'{name}.{public}', getattr(module, public))}\n```"


def _directive(name: str, value: Any) -> str:
    if inspect.isclass(value) and issubclass(value, Settings):
        return f".. autoclass:: {name}"  # its keys stand with the configuration files
    if inspect.isclass(value):
        return f".. autoclass:: {name}\n   :members:\n   :inherited-members: BaseModel, BaseException, str, object"
    if callable(value):
        return f".. autofunction:: {name}"
    return f".. py:data:: {name}\n\n   A mapping with the keys {', '.join(f'``{key}``' for key in value)}."


def code(_app: Any, _what: str, _name: str, _value: Any, _options: Any, lines: list[str]) -> None:
    """Mark what is indented after an empty line as code; before napoleon looks for sections."""
    for k in range(len(lines) - 3, -1, -1):
        text, gap, following = lines[k : k + 3]
        if text.strip() and not gap.strip() and _indent(following) > _indent(text):
            lines[k + 1 : k + 1] = ["", " " * _indent(text) + "::"]


def plain(_app: Any, _what: str, _name: str, _value: Any, _options: Any, lines: list[str]) -> None:
    """Escape what is markup to Sphinx and plain text to the author of a docstring; after napoleon."""
    for k, line in enumerate(lines):
        if _indent(line) < _CODE:
            lines[k] = _MARKUP.sub(lambda found: re.sub(r"[|_*]", r"\\\g<0>", found[0]), line)


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())

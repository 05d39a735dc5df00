"""What the site adds to Sphinx: text generated from the package stands where a page asks for it.

A page asks with a block of its own:

    ```{generated} configuration
    ```

The text is Markdown and replaces the block before the page is parsed, so that its headings are headings of the page.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from . import api, commands, configuration, effects, execution, files

SOURCES: Mapping[str, Callable[[], str]] = MappingProxyType(
    {
        "api": api.text,
        "commands": commands.text,
        "configuration": configuration.text,
        "effects": effects.text,
        "examples": files.text,
        "gallery": files.gallery,
        "metadata": configuration.metadata,
    }
)
EXECUTED = ("tutorials", "explanation")  # folders whose pages run
BLOCK = re.compile(r"^```\{generated\} (\w+)\n```$", re.MULTILINE)


def expanded(text: str) -> str:
    """A page with the generated text in the place of its blocks.

    Raises:
        KeyError: if a block asks for a text that there is not.
    """
    return BLOCK.sub(lambda block: SOURCES[block[1]](), text)


def _expand(app: Any, name: str, source: list[str]) -> None:
    source[0] = expanded(source[0])
    if not files.gallery():  # a checkout without these examples
        source[0] = source[0].replace("\ngallery/index\n", "\n")
    if name.partition("/")[0] in EXECUTED:
        source[0] = execution.executed(source[0], Path(app.srcdir) / name)


def setup(app: Any) -> dict[str, Any]:
    """Connect the texts to the pages, and draw the effects' pictures."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("source-read", _expand)
    app.connect("builder-inited", effects.draw)
    app.connect("autodoc-process-docstring", api.code, priority=100)
    app.connect("autodoc-process-docstring", api.plain, priority=900)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

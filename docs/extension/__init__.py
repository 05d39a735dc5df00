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

from . import api, commands, configuration, effects, execution, files, front

SOURCES: Mapping[str, Callable[[], str]] = MappingProxyType(
    {
        "api": api.text,
        "commands": commands.text,
        "configuration": configuration.text,
        "effects": effects.text,
        "examples": files.text,
        "front": front.text,
        "gallery": files.gallery,
        "metadata": configuration.metadata,
    }
)
EXECUTED = ("tutorials", "explanation")  # folders whose pages run
ASKED = re.compile(r"<(?:script|link|img)\b[^>]*\b(?:src|href)=\"(?:https?:)?//")
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


def _outdated(app: Any, env: Any, _added: set[str], _changed: set[str], _removed: set[str]) -> list[str]:
    """Pages made from the package, and pages that run, that were read before the package last changed."""
    newest = max(path.stat().st_mtime for path in sources())
    read = {name: Path(app.doctreedir) / f"{name}.doctree" for name in env.found_docs if _is_made(env, name)}
    return [name for name, file in read.items() if not file.exists() or file.stat().st_mtime < newest]


def _is_made(env: Any, name: str) -> bool:
    return name.partition("/")[0] in EXECUTED or bool(BLOCK.search(Path(env.doc2path(name)).read_text("utf-8")))


def asking(folder: Path) -> list[str]:
    """Pages of a built site that fetch a script, a style or a picture from another host."""
    return [page.name for page in sorted(folder.rglob("*.html")) if ASKED.search(page.read_text("utf-8"))]


def _offline(app: Any, error: Exception | None) -> None:
    if error is None and app.builder.name == "html" and (pages := asking(Path(app.outdir))):
        raise RuntimeError(f"pages ask other hosts, expected a site that needs no network: {', '.join(pages)}")


def sources() -> list[Path]:
    """Files of Python that the pages depend on: of the package and of this extension."""
    here = Path(__file__).resolve().parent
    rooms = [folder for folder in here.parents[1].iterdir() if (folder / "py.typed").exists()]
    return [file for folder in (*rooms, here) for file in folder.rglob("*.py")]


def setup(app: Any) -> dict[str, Any]:
    """Connect the texts to the pages, and draw the effects' pictures."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("source-read", _expand)
    app.connect("env-get-outdated", _outdated)
    app.connect("builder-inited", effects.draw)
    app.connect("build-finished", _offline)
    app.connect("autodoc-process-docstring", api.code, priority=100)
    app.connect("autodoc-process-docstring", api.plain, priority=900)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

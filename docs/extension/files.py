"""The example files, each with its first comment."""

from __future__ import annotations

import re
from pathlib import Path

from .tables import sentence, table

FOLDER = Path(__file__).resolve().parents[2] / "examples"


def text() -> str:
    """A table of the configuration files in `examples/`."""
    rows = [(f"[`{file.name}`](../../examples/{file.name})", _first(file)) for file in sorted(FOLDER.glob("*.yaml"))]
    return table(("file", "holds"), rows)


def gallery() -> str:
    """The card of the start page that leads to the gallery, where there is one."""
    if not any((FOLDER / "gallery").glob("plot_*.py")):
        return ""
    card = (":::{grid-item-card} Examples", ":link: gallery/index", ":link-type: doc")
    return "\n".join((*card, "See short scripts with the figures of their run, and download them.", ":::"))


def _first(file: Path) -> str:
    """The first line of a file, which is a comment, up to the command that uses the file."""
    line = file.read_text(encoding="utf-8").partition("\n")[0].removeprefix("#")
    return sentence(re.split(r"[:;]", line)[0].strip())

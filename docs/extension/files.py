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


def _first(file: Path) -> str:
    """The first line of a file, which is a comment, up to the command that uses the file."""
    line = file.read_text(encoding="utf-8").partition("\n")[0].removeprefix("#")
    return sentence(re.split(r"[:;]", line)[0].strip())

"""Command line, table and JSON file of the benchmarks."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table


def asked(doc: str | None, **options: Any) -> argparse.Namespace:
    """Options of the command line.

    Args:
        doc: of the program; it is the text of `--help`.
        options: by name a default, a default and its help, or the arguments of `argparse`; `place=True` among these
            makes it a positional one. A default of False makes a switch.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, option in options.items():
        words = dict(zip(("default", "help"), option, strict=False)) if isinstance(option, tuple) else option
        given: dict[str, Any] = dict(words) if isinstance(words, dict) else {"default": words}
        default = given.get("default")
        if default is False:
            given["action"] = "store_true"
        elif default is not None and not isinstance(default, list):
            given.setdefault("type", type(default))
        parser.add_argument(name if given.pop("place", False) else f"--{name.replace('_', '-')}", **given)
    return parser.parse_args()


def show(columns: Sequence[str], rows: Iterable[Sequence[object]], title: str | None = None, width: int = 140) -> None:
    """Print a table whose first column is text and whose others are numbers."""
    grid = Table(title=title, title_justify="left")
    for k, name in enumerate(columns):
        grid.add_column(name, justify="left" if k == 0 else "right")
    for row in rows:
        grid.add_row(*map(str, row))
    Console(width=width).print(grid)


def save(path: Path | None, data: object) -> None:
    """Write data as JSON if a file name is given."""
    if path is not None:
        path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")

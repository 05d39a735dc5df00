"""Consoles, lines and tables of the command line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table


def plain_console(**options: Any) -> Console:
    """Console that prints text without markup, since a file may be called `[/red].csv` or `:bell:.csv`."""
    return Console(markup=False, emoji=False, **options)


out = plain_console()
errors = plain_console(stderr=True)

INTERRUPTED = 130
"""Exit status of a command that the user ended."""


def line(text: str) -> None:
    """Print a line without line breaks on standard output."""
    out.print(text, soft_wrap=True, highlight=False)


def say(text: str, style: str = "yellow") -> None:
    """Print a note, a warning or an event on standard error; a note has no colour."""
    errors.print(text, style=None if text.startswith("note:") else style, soft_wrap=True, highlight=False)


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], last_apart: bool = False) -> Table:
    """Table with text in the first column and numbers in the others; the last row may be separate."""
    grid = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for k, name in enumerate(columns):
        grid.add_column(name, justify="left" if k == 0 else "right", overflow="fold")
    for k, row in enumerate(rows):
        if last_apart and k == len(rows) - 1:
            grid.add_section()
        grid.add_row(*row)
    return grid

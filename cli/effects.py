"""`hystmpc effects`: the library of effects, as a table, as JSON, as pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.effects.place import library_data, parameter_lines
from hystmpc.trials.run_folder import require_vacant

from .console import out


def effects(
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder for a picture of each effect and one HTML page; new or empty.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the library as JSON.")] = False,
) -> None:
    """List the effects that can be put into any simulator.

    Equation, parameters, units, bounds, sides.
    """
    if folder is not None:
        page = _pictures(folder)
        if not as_json:
            out.print(f"pictures and page: {page}", soft_wrap=True)
    if as_json:
        typer.echo(json.dumps(library_data(), indent=1))
    elif folder is None:
        grid = Table(box=SIMPLE_HEAD, pad_edge=False)
        grid.add_column("effect and sides", no_wrap=True)
        grid.add_column("equation; parameters with unit, bounds, neutral value", overflow="fold")
        for effect in EFFECTS.values():
            lines = "\n".join((effect.equation, *(f"  {line}" for line in parameter_lines(effect))))
            grid.add_row(f"{effect.name}\n  {', '.join(effect.sides)}", lines, end_section=True)
        out.print(grid)


def _pictures(folder: Path) -> Path:
    """Draw all of them; returns the page.

    Raises:
        ConfigError: if the folder is not new or empty, or cannot be written.
    """
    from hystmpc.models.effects.pictures import write_pictures

    require_vacant(folder)
    return write_pictures(folder)

"""`hystmpc new`: a folder to begin with, for a class of your own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import out


def new(
    kind: Annotated[str, typer.Argument(help="Kind of class: transport, effect or controller.")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder.")],
) -> None:
    """Write a class to fill in, its contract tests, which pass as they are, and a file to try it with."""
    from hystmpc.testing.new import write_template

    for file in write_template(kind, folder):
        out.print(str(file), soft_wrap=True, markup=False)
    out.print(f"next: cd {folder} && pytest", soft_wrap=True, markup=False)

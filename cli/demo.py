"""`hystmpc demo`: the main job without any data of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import bar, out


def demo(
    folder: Annotated[Path, typer.Option("--out", help="Run folder to make; new or empty.")] = Path("demo"),
) -> None:
    """Track a point-to-point motion and a scan with every controller on the simulated tendon catheter that ships."""
    from hystmpc.sim.demo import demo as run_demo  # kept out of the way of the other verbs' start

    from .simulate import print_study

    with bar("demo") as show:
        result = run_demo(folder, lambda done, total: show(done, total=total))
    print_study(result)
    out.print(f"report: {folder / 'report.html'}")

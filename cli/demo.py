"""`hystmpc demo`: the main job without any data of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    folder: Annotated[Path, typer.Option("--out", help="Run folder to make; new or empty.")] = Path("demo"),
) -> None:
    """Track two motions with every controller on a simulated device.

    A point-to-point motion and a scan, on the tendon catheter that ships.
    """
    from hystmpc.sim.compare import demo as run_demo  # kept out of the way of the other verbs' start

    from .simulate import show_study

    show_study("demo", folder, lambda progress: run_demo(folder, progress))

"""Verb `hystmpc data make`: the papers' data sets on the simulated devices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.cli.bars import progress_of
from hystmpc.cli.console import out, table
from hystmpc.trials.run_folder import require_vacant

data = typer.Typer(no_args_is_help=True, help="Data sets of the papers, recorded on simulated devices.")


@data.callback()
def _group() -> None:
    """Data sets of the papers, recorded on simulated devices."""


@data.command()
def make(
    name: Annotated[
        str,
        typer.Argument(
            metavar="s1|s2|rod", help="s1: muscle catheter; s2: tendon catheter; rod: the motions of s2 on the rod."
        ),
    ],
    folder: Annotated[Path, typer.Option("--out", help="Folder to make; new or empty.")],
    seed: Annotated[int, typer.Option("--seed", help="Of devices, motions and noise.", min=0)] = 0,
) -> None:
    """Record a whole data set and write it as canonical CSV files with a manifest; all of it or nothing."""
    from ..datasets import make_dataset, write_dataset

    require_vacant(folder)
    with progress_of("record") as progress:
        made = make_dataset(name, seed, progress=progress)
    with progress_of("write") as progress:
        write_dataset(made, folder, progress)
    rows = [
        [split, str(len(trials)), str(made.samples[split]), f"{sum(t.duration_s for t in trials):.0f}"]
        for split, trials in made.splits.items()
    ]
    out.print(table(f"data set {name}, simulated, seed {seed}", ("split", "trials", "samples", "seconds"), rows))
    out.print(f"manifest: {folder / 'manifest.yaml'}")

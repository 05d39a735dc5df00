"""Arguments and options that several verbs take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.trials.layouts import LAYOUTS

_LAYOUTS = ", ".join(layout.name for layout in LAYOUTS)

Logs = Annotated[
    list[Path], typer.Argument(metavar="LOG", help="Recorded trials (csv, xlsx, mat, ROS bag, ...) or folders of them.")
]
LayoutName = Annotated[
    str, typer.Option("--layout", help=f"Layout of the logs: auto, {_LAYOUTS}, or a mapping file *.yaml.")
]
SampledHz = Annotated[
    float | None,
    typer.Option("--sampled-hz", help="Rate [Hz] of logs sampled evenly; stands in for a broken or missing clock."),
]
Sim = Annotated[
    Path | None, typer.Option("--sim", help="Simulator: .yaml of `fit`, an exported .onnx model, or builtin:NAME.")
]
AllowPython = Annotated[
    bool,
    typer.Option("--allow-python", help="Import classes that the file names as python: MODULE:CLASS; you trust it."),
]
SkipFirstFlexure = Annotated[
    bool, typer.Option("--skip-first-flexure", help="Count each trial only from the command's first reversal on.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace an older file of the same kind; never one of another.")]
Page = Annotated[Path | None, typer.Option("--report", help="Write one page with tables and figures here, .html.")]
Figures = Annotated[
    Path | None,
    typer.Option("--figures", help="New folder for every figure of the report: SVG, PDF, and its data as CSV."),
]
Overrides = Annotated[list[str] | None, typer.Option("--set", help="Change a setting of the file: KEY.KEY=VALUE.")]
Cluster = Annotated[
    str | None, typer.Option(help="Dask scheduler, tcp://host:8786; `local`: processes of this machine.")
]

"""The program `hystmpc`: its verbs, and how errors and Ctrl-C end it."""

from __future__ import annotations

import sys
from typing import NoReturn

import typer

from hystmpc.trials.errors import HystmpcError

from .bench import bench
from .check import check
from .console import errors
from .data import data
from .demo import demo
from .device import device
from .diagnose import diagnose
from .effects import effects
from .evaluate import evaluate
from .export import export
from .faults import faults
from .fit import fit
from .gap import gap
from .record import record
from .report import report
from .run import run
from .simulate import simulate
from .study import study
from .tune import tune

UNUSABLE = 2

app = typer.Typer(
    name="hystmpc",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Inverse-model predictive control for actuators with hysteresis: check and fit recorded trials, export "
    "models to ONNX, track tip angles in simulation, compare controllers.",
)
for verb in (
    check,
    fit,
    evaluate,
    export,
    diagnose,
    simulate,
    report,
    demo,
    bench,
    study,
    tune,
    effects,
    run,
    record,
    device,
    faults,
):
    app.command()(verb)
app.add_typer(data, name="data")
app.add_typer(gap, name="gap")


def main() -> None:
    """Run the program; one line on standard error and exit code 2 for unusable input, 130 after Ctrl-C."""
    try:
        app()
    except HystmpcError as error:
        _end(str(error))
    except OSError as error:  # a full disk, a file that may not be read: the machine's, not a defect of the program
        _end(f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error))


def _end(text: str) -> NoReturn:
    line = " ".join(text.split())
    errors.print(f"error: {line}", style="red", soft_wrap=True, highlight=False)
    sys.exit(UNUSABLE)

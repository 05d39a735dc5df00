"""Verb `hystmpc bench`: speed of hystmpc on this machine compared with its peers and its limit."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hystmpc.cli.bars import progress_of
from hystmpc.cli.console import INTERRUPTED, errors, out, plain_console, table
from hystmpc.tasks.outputs import BENCHMARK, check_output
from hystmpc.trials.files import write_atomically
from hystmpc.trials.run_folder import require_vacant

if TYPE_CHECKING:
    from rich.console import Console

    from ..performance.report import BenchReport

_WIDTH = 220  # of the table in a file
_TEXT = ("measured", "against", "ratio", "goal", "note")


def bench(
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder for table, JSON and figures; new or empty.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write hystmpc-bench/1 here.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few repetitions: rough ratios.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an older file of the same kind.")] = False,
) -> None:
    """Time the controllers and their peers on this machine.

    In turns with CasADi, pytorch-mppi and the best matrix product.

    Ctrl-C ends with what has been measured, exit code 130.
    """
    from ..performance.growth import save_growth
    from ..performance.report import report_json
    from ..performance.run import run_bench
    from ..performance.subjects import QUICK, BenchSettings

    if json_file is not None:
        check_output("--json", json_file, (BENCHMARK,), (), force)
    if folder is not None:
        require_vacant(folder)
    with progress_of("bench") as progress:
        report = run_bench(QUICK if quick else BenchSettings(), progress)
    _print(report, out)
    content = json.dumps(report_json(report), indent=2) + "\n"
    if json_file is not None:
        write_atomically(json_file, content)
    if folder is not None:
        write_atomically(folder / "bench.json", content)
        _write_table(report, folder / "bench.txt")
        save_growth(report.growth, folder)
    if report.interrupted:
        errors.print("interrupted: what was measured by then is above", style="yellow")
        raise typer.Exit(INTERRUPTED)


def _print(report: BenchReport, console: Console) -> None:
    from ..performance.report import COLUMNS, table_rows

    for name, source in report.models.items():
        console.print(f"{name}: {source}", highlight=False)
    grid = table(_title(report), COLUMNS, table_rows(report))
    for name, column in zip(COLUMNS, grid.columns, strict=True):
        column.no_wrap = False  # its texts are longer than a terminal leaves them
        if name in _TEXT:
            column.justify = "left"
    console.print(grid)
    for one in report.growth:
        verdict = "" if one.reached is None else f", goal at most {one.goal:g}: {'yes' if one.reached else 'no'}"
        sizes = f"{one.values[-2]} to {one.values[-1]}"
        console.print(f"{one.what} grows as {one.size}^{one.exponent:.2f} from {sizes}{verdict}", highlight=False)


def _title(report: BenchReport) -> str:
    machine = report.machine
    load, cores = machine["load_at_start"], machine["cores"]
    busy = "" if load is None or load < 0.5 else f"; load {load:.1f} at the start: close other work for clean figures"
    return f"medians on {machine['processor']}, {cores} cores, Python {machine['python']}{busy}"


def _write_table(report: BenchReport, path: Path) -> None:
    text = io.StringIO()
    _print(report, plain_console(width=_WIDTH, file=text))
    write_atomically(path, text.getvalue())

"""`hystmpc bench`: how fast is this machine's hystmpc beside its peers and its limit?"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Annotated

import typer
from hystmpc.sim.bench.report import Report, report_json
from hystmpc.sim.bench.run import run_bench
from hystmpc.sim.bench.settings import QUICK, BenchSettings
from hystmpc.sim.bench.table import COLUMNS, table_rows
from hystmpc.trials.files import write_atomically
from rich.console import Console

from .console import bar, errors, out, table

_WIDTH = 220  # of the table in a file


def bench(
    folder: Annotated[Path | None, typer.Option("--out", help="Write bench.json and bench.txt into this folder.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write hystmpc-bench/1 here.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A few repetitions only: everything runs, ratios are rough.")] = False,
) -> int:
    """Time the controllers in turns with CasADi, pytorch-mppi and the best matrix product; exit code 130 after Ctrl-C."""
    with bar("bench") as show:
        report = run_bench(QUICK if quick else BenchSettings(), show)
    _print(report, out)
    content = json.dumps(report_json(report), indent=2) + "\n"
    if json_file is not None:
        write_atomically(json_file, content)
    if folder is not None:
        write_atomically(folder / "bench.json", content)
        _write_table(report, folder / "bench.txt")
    if report.interrupted:
        errors.print("interrupted: what was measured by then is above", style="yellow")
    return 130 if report.interrupted else 0


def _print(report: Report, console: Console) -> None:
    for name, source in report.models.items():
        console.print(f"{name}: {source}", highlight=False)
    console.print(table(_title(report), COLUMNS, table_rows(report)))


def _title(report: Report) -> str:
    machine = report.machine
    return f"medians on {machine['processor']}, {machine['cores']} cores, Python {machine['python']}"


def _write_table(report: Report, path: Path) -> None:
    text = io.StringIO()
    _print(report, Console(width=_WIDTH, file=text))
    write_atomically(path, text.getvalue())

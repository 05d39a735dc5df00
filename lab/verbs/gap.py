"""`hystmpc gap rod`, and `hystmpc gap blind make|run|order|investigate|score|record|ablate`: the diagnosis tested."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hystmpc.cli.bars import progress_of
from hystmpc.cli.console import errors, out, table
from hystmpc.models.simulator import load_simulator
from hystmpc.trials.read import read_trials
from hystmpc.trials.run_folder import require_vacant

if TYPE_CHECKING:
    from ..blind.ablation import Ablated


gap = typer.Typer(no_args_is_help=True, help="The sim-to-real diagnosis put to the test.")
blind = typer.Typer(no_args_is_help=True, help="Sealed cases with known causes: make, run, order, investigate, score.")
gap.add_typer(blind, name="blind")

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of `hystmpc gap blind make`.")]
Logs = Annotated[list[Path], typer.Argument(metavar="LOG", help="Recorded trials or folders of them.")]
LayoutName = Annotated[
    str, typer.Option("--layout", help="Layout of the logs: auto, a name, or a mapping file *.yaml.")
]
Jobs = Annotated[int | None, typer.Option(min=1, help="Processes, one thread each; else one a core.")]


@gap.callback()
def _group() -> None:
    """The sim-to-real diagnosis put to the test."""


@gap.command()
def rod(
    seed: Annotated[int, typer.Option(min=0, help="Of the catheter.")],
    cause: Annotated[list[str] | None, typer.Option(help="Line of the table; repeatable; else all.")] = None,
) -> None:
    """Diagnose causes that were missed before, and mixtures, on a long catheter with dry friction in its joints."""
    from ..blind.long_rod import COLUMNS, missed_lines, row

    with progress_of("diagnose") as progress:
        found = missed_lines(seed, cause or (), progress)
    out.print(table(f"long catheter {seed}", COLUMNS, [row(said) for said in found]))
    exact, wrong = (sum(getattr(said, name) for said in found) for name in ("exact", "wrong"))
    out.print(f"exact {exact}, wrong names {wrong}, of {len(found)}")


@blind.command()
def make(
    folder: Annotated[Path, typer.Option("--out", help="Folder to make; new or empty.")],
    seed: Annotated[int, typer.Option(min=0, help="Of everything; one never used in development.")],
    cases: Annotated[
        int | None, typer.Option(min=1, help="How many; else one round of all suites: 223, or 239 with logs.")
    ] = None,
    suite: Annotated[
        str,
        typer.Option(
            help="all, single, none, misset, controls, retuned, pairs, triple, contaminated, unknown, without, "
            "configuration, aliased, injection."
        ),
    ] = "all",
    logs: Annotated[
        list[Path] | None, typer.Option(help="Real logs of one device or a folder of them, for injection; repeatable.")
    ] = None,
    layout: LayoutName = "auto",
    jobs: Jobs = None,
    own_simulator: Annotated[
        int,
        typer.Option(min=0, help="Of so many cases one has what the unaffected device gives, as simulated_deg."),
    ] = 3,
) -> None:
    """Write cases without labels, and their answers in one sealed file."""
    from ..blind.make import make_blind  # kept out of the way of the other verbs' start

    with progress_of("make cases") as progress:
        manifest = make_blind(folder, seed, cases, suite, logs or [], jobs or _cores(), progress, layout, own_simulator)
    out.print(f"{len(manifest.cases)} cases in {folder / 'cases'}; answers sealed, sha256 {manifest.answers_sha256}")


@blind.command()
def run(
    folder: Folder,
    jobs: Jobs = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the diagnoses.")] = 0,
    follow_up: Annotated[
        bool, typer.Option("--follow-up", help="Record the proposed motions too, and diagnose again with them.")
    ] = False,
    without_truth: Annotated[
        bool, typer.Option("--without-truth", help="Leave out the oracle, which is told the true classes.")
    ] = False,
) -> None:
    """Diagnose every case that is not diagnosed yet; Ctrl-C keeps what is done."""
    from ..blind.run import run_blind

    with progress_of("diagnose", kept=_kept("diagnoses", folder)) as progress:
        failed = run_blind(folder, jobs or _cores(), seed, follow_up, not without_truth, progress)
    _say_failed(failed, "diagnoses")
    out.print(f"diagnoses: {folder / 'diagnoses'}")


@blind.command()
def order(
    folder: Folder,
    cases: Annotated[int, typer.Option(min=1, help="How many of the cases, the first ones.")] = 20,
    orders: Annotated[int, typer.Option(min=1, help="Random orders of the files of each.")] = 10,
    jobs: Jobs = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the diagnoses and the orders.")] = 0,
) -> None:
    """Diagnose cases in random orders of their files, order unknown; the names should be the same."""
    from ..blind.bars import orders_of
    from ..blind.run import run_orders

    with progress_of("diagnose in orders", kept=_kept("diagnoses", folder)) as progress:
        failed = run_orders(folder, cases, orders, jobs or _cores(), seed, progress)
    _say_failed(failed, "diagnoses")
    rows, found = orders_of(folder)
    columns = ("case", "orders", "sets of names")
    out.print(table(f"names in {orders} orders of the files", columns, [[*map(str, row)] for row in rows]))
    low, high = found.ci90 or (0.0, 1.0)
    out.print(f"same names: {found.value:.3f} ({low:.2f} to {high:.2f}) of {found.cases}, goal {found.goal}")


@blind.command()
def investigate(
    folder: Folder,
    minutes: Annotated[float, typer.Option(min=1, max=30, help="Device time of each at most.")] = 5.0,
    jobs: Jobs = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the investigations.")] = 1,
) -> None:
    """Play `hystmpc investigate` on the device of every single effect; Ctrl-C keeps what is done."""
    from ..blind.investigated import FOLDER, investigate_blind

    with progress_of("investigate", kept=_kept("investigations", folder)) as progress:
        failed = investigate_blind(folder, minutes, jobs or _cores(), seed, progress)
    _say_failed(failed, "investigations")
    out.print(f"investigations: {folder / FOLDER}")


@blind.command()
def score(
    folder: Folder,
    partial: Annotated[bool, typer.Option("--partial", help="Score what is diagnosed so far.")] = False,
) -> None:
    """Open the answers and score the diagnoses: score.json and report.html."""
    from ..blind.report import BAR_COLUMNS, bar_row, write_report
    from ..blind.score import miss_json, score_blind

    found = score_blind(folder, partial)
    rows = [[str(cell) for cell in bar_row(item)] for item in found.bars]
    out.print(table(f"blind check, {len(found.cases)} cases", BAR_COLUMNS, rows))
    for name in ("suite", "gap in floors", "recording plan"):
        groups = [[key, f"{r.value:.2f}", str(r.cases)] for key, r in found.groups[name].items()]
        out.print(table("right verdicts", (name, "right", "cases"), groups))
    rows = [[str(cell) for cell in bar_row(item)] for item in found.metrics]
    out.print(table("the metrics of the DX 2025 competition; goal: its winner", BAR_COLUMNS, rows))
    misses = [miss_json(case) for case in found.misses()]
    lines = [
        [m["case"], m["suite"], m["truth"], m["verdict"], ", ".join(m["said"]) or "-", f"{m['ratio']:.1f}", m["miss"]]
        for m in misses
    ]
    columns = ("case", "suite", "truth", "verdict", "said", "floors", "what is wrong")
    out.print(table(f"wrong verdicts: {len(misses)} of {len(found.cases)}", columns, lines))
    out.print(f"report: {write_report(found, folder)}")


@blind.command()
def ablate(
    logs: Logs,
    sim: Annotated[Path, typer.Option("--sim", help="Simulator with effects, such as a diagnosis' sim.fixed.yaml.")],
    folder: Annotated[Path, typer.Option("--out", help="Folder to make; new or empty.")],
    layout: LayoutName = "auto",
    seed: Annotated[int, typer.Option(min=0, help="Of the diagnoses.")] = 0,
) -> None:
    """Take each effect out of a simulator of real logs, and ask the diagnosis for its name."""
    from ..blind.ablation import ablate as ablate_all

    require_vacant(folder)
    trials, simulator = read_trials(logs, layout), load_simulator(sim)
    with progress_of("ablate") as progress:
        rows = ablate_all(trials, simulator, folder, seed, progress)
    cells = []
    for row in rows:
        answer = ("not needed", "", "") if not row.needed else (row.verdict, ", ".join(row.said) or "-", _mark(row))
        cells.append(
            [row.component, f"{row.with_deg:.3f}", f"{row.without_deg:.3f}", f"{row.standard_errors:.1f}", *answer]
        )
    columns = ("component", "RMSE with, deg", "without", "rise in s.e.", "verdict", "said", "right")
    out.print(table(f"ablation on {len(trials)} logs", columns, cells))
    out.print(f"floor {rows[0].floor_deg:.3f} deg; written: {folder / 'ablation.json'}")


def _mark(row: Ablated) -> str:
    return "yes" if row.right else "among them" if row.found else "no"


@blind.command()
def record(
    folder: Folder,
    case: Annotated[str, typer.Argument(help="Name of the case's folder, such as 007.")],
    motion: Annotated[Path, typer.Argument(help="CSV with time_s and command, such as next_motion.csv.")],
) -> None:
    """Run a further motion on the device of a case and write its log."""
    from ..blind.run import record_motion

    out.print(f"recorded: {record_motion(folder, case, motion)}")


def _kept(what: str, folder: Path) -> str:
    return f"interrupted: finished {what} are kept in {folder}, the same command goes on"


def _say_failed(failed: int, what: str) -> None:
    if failed:
        errors.print(f"{failed} {what} failed, see failure.txt beside them; the same command tries again")


def _cores() -> int:
    return os.cpu_count() or 1

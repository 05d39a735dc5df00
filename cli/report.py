"""`hystmpc report`: the report of a run folder, made anew from what lies in it."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.figure_folder import figures_to
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.run_folder import RunFolder

from .bars import bar
from .console import out
from .options import Figures, check_figures

if TYPE_CHECKING:
    from hystmpc.trials.report import Piece


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder, or that of a commissioning.")],
    before: Annotated[
        list[Path] | None, typer.Option("--before", help="Earlier run on the same reference; repeatable.")
    ] = None,
    diagnosis: Annotated[
        Path | None, typer.Option("--diagnosis", help="Folder of `diagnose`: the fall that it lets expect.")
    ] = None,
    figures: Figures = None,
) -> None:
    """Write report.html of a run folder again.

    Of an experiment it says what is due: nothing, `fit` or `diagnose`. With an earlier run it says how far the tracking
    error fell, and with a diagnosis how far it was expected to fall on this reference.
    """
    check_figures(figures)
    with bar("report"), figures_to(figures), only_reads():
        _report(run, before, diagnosis)


def _report(run: Path, before: list[Path] | None, diagnosis: Path | None) -> None:
    keys = _settings_of(run)
    if "commissioning" in keys:
        _commissioning(run, before, diagnosis)
        return
    more = _fall(run, before or [], diagnosis)
    if {"transport", "sensor", "reference"} <= keys:
        from hystmpc.rig.commission.review_page import review_run

        for line in review_run(run, more).lines:
            out.print(f"review: {line}", soft_wrap=True, markup=False)
        out.print(f"report: {run / 'report.html'}", soft_wrap=True)
    elif {"transport", "sensor", "excitations"} <= keys:
        from hystmpc.rig.recording.report import write_report

        out.print(f"report: {write_report(RunFolder.open(run))}", soft_wrap=True)
    else:
        from hystmpc.sim.report import report_from_folder

        out.print(f"report: {report_from_folder(run, more)}")


def _commissioning(run: Path, before: list[Path] | None, diagnosis: Path | None) -> None:
    """The report of a commissioning; it compares with no other run."""
    if before or diagnosis is not None:
        raise ConfigError("report: a commissioning has no use for --before and --diagnosis, expected a run of `run`")
    from hystmpc.commissioning.run import report_again

    out.print(f"report: {report_again(run).report}", soft_wrap=True)


def _fall(run: Path, before: list[Path], diagnosis: Path | None) -> tuple[Piece, ...]:
    """Print how far the error fell; returns it for the page."""
    if not before and diagnosis is None:
        return ()
    from hystmpc.gap.tracking.measured import fall_lines, fall_pieces, tracking_falls

    falls = tracking_falls(run, before, diagnosis)
    for line in fall_lines(falls):
        out.print(line, soft_wrap=True, highlight=False)
    return fall_pieces(falls)


def _settings_of(run: Path) -> Set[str]:
    """The keys of the run's settings; none where there are none."""
    file = run / "config.yaml"
    settings = read_yaml(file) if file.is_file() else None
    return settings.keys() if isinstance(settings, dict) else frozenset()

"""The jobs of a study on the command line: how long, a bar, what Ctrl-C keeps, what failed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import typer

from hystmpc.cli.bars import bar
from hystmpc.cli.console import INTERRUPTED, errors, out
from hystmpc.trials.types import Progress

if TYPE_CHECKING:
    from ..ready import ReadyStudy


class Failure(Protocol):
    """A result that holds an error."""

    @property
    def job(self) -> Any:
        """With its `key`."""
        ...

    @property
    def message(self) -> str:
        """The error in one line."""
        ...


class Outcome(Protocol):
    """What a study has come to."""

    @property
    def results(self) -> Sequence[Any]:
        """Of all jobs."""
        ...

    @property
    def failed(self) -> Sequence[Failure]:
        """Those that hold an error."""
        ...


R = TypeVar("R", bound=Outcome)


def completed(ready: ReadyStudy[Any, Any, Any], name: str, workers: int, run: Callable[[Progress], R]) -> R:
    """Do the open jobs of a study: the time it will take, a bar with the time left, and what failed.

    Raises:
        typer.Exit: with 130 if the user ended it.
    """
    minutes = ready.minutes(workers)
    errors.print(f"{len(ready.costs)} of {len(ready.jobs)} jobs to do on {workers} cores: about {minutes} min")
    try:
        with bar(f"study {name}", sum(ready.costs.values())) as show:
            outcome = run(lambda done, total, note="": show(done, note, total=total))
    except KeyboardInterrupt:
        kept = f"finished jobs are kept in {ready.folder.path}, the same command goes on"
        errors.print(f"interrupted: {kept}", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    for failed in outcome.failed:
        errors.print(f"failed: {failed.job.key}: {failed.message}", style="red", highlight=False)
    return outcome


def ended(outcome: Outcome, folder: Path) -> None:
    """Say how many jobs are done and where the report is."""
    done = len(outcome.results) - len(outcome.failed)
    out.print(f"{done} jobs done, {len(outcome.failed)} failed; report: {folder / 'report.html'}")

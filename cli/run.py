"""`hystmpc run`: a closed-loop experiment on a device."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.rig.bench import BenchResult, reset_latch
from hystmpc.rig.config import BenchSettings, load_run
from hystmpc.rig.histogram import TimingSummary

from .console import errors, out, table
from .device import plants_in

STOPPED = 3

Reset = Annotated[bool, typer.Option("--reset", help="Release a latched stop first: you have looked at the device.")]


def run(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="Bench, controller and reference (YAML).")],
    folder: Annotated[Path, typer.Option("--out", help="Run folder, new or empty.")],
    overrides: Annotated[list[str] | None, typer.Option("--set", help="Change a setting: rate_hz=50.")] = None,
    reset: Reset = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show angle, command, timing and faults in the terminal.")
    ] = False,
    page: Annotated[bool, typer.Option("--page", help="Show them on a local page.")] = False,
) -> None:
    """Prepare the device, track the reference, return to the safe command; exit code 3 after a safe stop."""
    from hystmpc.rig.experiment import run_experiment
    from hystmpc.rig.recording import RecordingMeta, open_apart
    from hystmpc.rig.recording.apart import Views
    from hystmpc.rig.review import review_run

    settings = load_run(config, overrides or ())
    if reset:
        reset_latch(settings)
    model = settings.controller.model
    meta = RecordingMeta(
        settings.command_unit,
        models=() if model.startswith("builtin:") else (Path(model),),
        stages=("estimate", "law", "advance", "total", "execution"),
    )
    result = run_experiment(
        settings,
        lambda: open_apart(folder, settings, meta, settings.rate_hz, Views(terminal=live, page=page), tell),
        plants_in(config.resolve().parent, settings.command_unit),
        folder=folder,
        note=tell,
    )
    finish(settings, result)
    review = review_run(folder)
    out.print(f"review: {review.advice}", soft_wrap=True, markup=False)
    out.print(f"report: {folder / 'report.html'}", soft_wrap=True)
    end(result)


def tell(text: str) -> None:
    """One line to whoever stands beside the device."""
    errors.print(text, style="yellow", soft_wrap=True, markup=False, highlight=False)


def finish(settings: BenchSettings, result: BenchResult) -> None:
    """Timing as a table, then faults, then how it ended."""
    timings, outcome = result.timings, result.outcome
    rows = [
        _row("period", timings.period.summary()),
        _row("execution", timings.execution.summary()),
        _row("wake-up jitter", timings.jitter.summary()),
    ]
    title = (
        f"{outcome.samples} samples at {settings.rate_hz:g} Hz [ms]; {timings.missed} missed, {timings.skipped} skipped"
    )
    out.print(table(title, ("", "median", "p99", "p99.9", "greatest"), rows))
    if outcome.faults:
        out.print("faults: " + ", ".join(f"{n} {name}" for name, n in sorted(outcome.faults.items())), soft_wrap=True)
    if outcome.cause:
        took = f"{outcome.safe_s - outcome.stop_s:.2f} s later" if outcome.safe_s == outcome.safe_s else "never"
        errors.print(
            f"stopped: {outcome.cause}; safe command {settings.safe_command:g} {settings.command_unit} held {took}; "
            "latched until --reset",
            style="red",
            soft_wrap=True,
            markup=False,
        )


def end(result: BenchResult) -> None:
    """Exit code 3 after a stop.

    Raises:
        Exit: of typer.
    """
    if result.outcome.cause:
        raise typer.Exit(STOPPED)


def _row(name: str, times: TimingSummary) -> list[str]:
    values = (times.median_s, times.p99_s, times.p999_s, times.greatest_s)
    return [name, *(f"{1e3 * value:.3f}" for value in values)]

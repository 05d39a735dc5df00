"""What `run` and `record` share: options, the recording, and how the end of a run is said."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hystmpc.rig.config import BenchSettings
from hystmpc.rig.histogram import TimingSummary
from hystmpc.rig.loop import RunOutcome
from hystmpc.rig.run import BenchResult, reset_latch
from hystmpc.trials.run_folder import require_vacant

from .console import errors, out, say, table

if TYPE_CHECKING:
    from hystmpc.rig.live.desk import Desk, LiveSettings
    from hystmpc.rig.recording.recorder_process import RecorderProcess, Views
    from hystmpc.rig.recording.recording import RecordingMeta
    from hystmpc.tasks.commission import DevicePlan

STOPPED = 3
ENDED_EARLY = 1

Folder = Annotated[Path, typer.Option("--out", help="Run folder, new or empty.")]
Reset = Annotated[bool, typer.Option("--reset", help="Release a latched stop first: you have looked at the device.")]
InTerminal = Annotated[bool, typer.Option("--live", help="Show angle, command, timing and faults in the terminal.")]
OnPage = Annotated[bool, typer.Option("--page", help="Show them on a local page.")]


def begin(settings: BenchSettings, folder: Path, reset: bool) -> None:
    """Refuse a folder that holds something; release the latch where that is asked for.

    Raises:
        ConfigError: if the folder is not new or empty, or another program controls the device now.
    """
    require_vacant(folder)
    if reset:
        reset_latch(settings)


def views_of(live: LiveSettings, terminal: bool, page: bool) -> Views:
    """What the options and the block `live` ask for: a page from which something may be asked is always served."""
    from hystmpc.rig.recording.recorder_process import Views

    return Views(terminal=terminal, page=page or live.control, host=live.host, port=live.port)


def recording_in(
    folder: Path, settings: BenchSettings, meta: RecordingMeta, views: Views, desk: Desk, report: bool = True
) -> Callable[[], RecorderProcess]:
    """Opens the recording when the device has answered, not before; the page's address, if there is one, is told."""
    from hystmpc.rig.recording.recorder_process import open_recorder_process

    def opened() -> RecorderProcess:
        recorder = open_recorder_process(folder, settings, meta, settings.rate_hz, views, say, report, desk)
        if recorder.page:
            say(f"live page: {recorder.page}")
        if not desk.started:
            say("nothing moves before Start is pressed on the page")
        return recorder

    return opened


def print_plan(plan: DevicePlan, part: str) -> None:
    """Parts, motions, minutes and limits, before anything moves."""
    rows = [(name, what, f"{minutes:.1f}") for name, what, minutes in plan.rows]
    grid = table(plan.title, (part, "motions", "min"), rows, True)
    grid.columns[1].justify = "left"
    out.print(grid)
    out.print(plan.limits, soft_wrap=True)


def finish(settings: BenchSettings, result: BenchResult) -> None:
    """Timing as a table, then faults, then how it ended; to nobody where the terminal has been closed."""
    if result.outcome.cause == "SIGHUP":
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - for the rest of the process
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
        errors.print(
            f"stopped: {outcome.cause}; {_end_of(settings, outcome)}; latched until --reset",
            style="red",
            soft_wrap=True,
            markup=False,
        )


def _end_of(settings: BenchSettings, outcome: RunOutcome) -> str:
    """What became of the safe command, in words that claim no more than the device has said."""
    safe = f"safe command {settings.safe_command:g} {settings.command_unit}"
    if math.isnan(outcome.safe_s):
        return f"{safe} not sent: the device's own watchdog has to act, look at the device"
    took = f"{outcome.safe_s - outcome.stop_s:.2f} s later"
    if outcome.confirmed:
        return f"{safe} held {took}"
    return f"{safe} sent {took}, the device has not said that it holds it"


def end(result: BenchResult) -> None:
    """Exit code 3 after a stop.

    Raises:
        Exit: of typer.
    """
    if result.outcome.cause:
        raise typer.Exit(STOPPED)


@contextmanager
def stages_kept(folder: Path | None) -> Iterator[None]:
    """Say how a device that was moved stage by stage has stopped, as `run` says it, or why a stage was not completed.

    Raises:
        Exit: of typer.
    """
    from hystmpc.bench.device import DeviceStoppedError
    from hystmpc.bench.stages import EndedEarlyError

    try:
        yield
    except DeviceStoppedError as stop:
        finish(stop.settings, stop.result)
        say(f"complete trials are kept in {folder}; look at the device, then the same command with --reset goes on")
        end(stop.result)
        raise
    except EndedEarlyError as error:
        errors.print(f"error: {error}", style="red", soft_wrap=True, highlight=False)
        raise typer.Exit(ENDED_EARLY) from None


def _row(name: str, times: TimingSummary) -> list[str]:
    values = (times.median_s, times.p99_s, times.p999_s, times.greatest_s)
    return [name, *(f"{1e3 * value:.3f}" for value in values)]

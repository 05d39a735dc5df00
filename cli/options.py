"""Arguments and options that several verbs take, and the trials behind them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from hystmpc.trials.check import Severity, check, require_seconds
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.layouts import PRESETS
from hystmpc.trials.read import expand_logs, read_trials
from hystmpc.trials.trial import Trial, resample

from .console import errors

_LAYOUTS = ", ".join(preset.name for preset in PRESETS)

Logs = Annotated[
    list[Path], typer.Argument(metavar="LOG", help="Recorded trials (csv, mcap, ROS 2 bag, mat) or folders of them.")
]
Layout = Annotated[
    str, typer.Option("--preset", help=f"Layout of the logs: auto, {_LAYOUTS}, or a mapping file *.yaml.")
]
SkipFirstFlexure = Annotated[
    bool, typer.Option("--skip-first-flexure", help="Count each trial only from the command's first reversal on.")
]


def processes(jobs: int | None) -> int:
    """How many worker processes `--jobs` asks for; one a core where it is left out.

    Raises:
        ConfigError: if it is below 1.
    """
    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs: got {jobs}, expected 1 or more; left out it is one a core, here {os.cpu_count()}")
    return jobs or os.cpu_count() or 1


def files_read(logs: Sequence[Path], layout: str) -> list[Path]:
    """Files that stand behind `LOG...` and `--preset`.

    Raises:
        LogError: if a folder holds no log.
    """
    return [*expand_logs(logs), Path(layout)]


def trials_at(logs: Sequence[Path], layout: str, rate_hz: float) -> list[Trial]:
    """Read logs and resample them; say what seems to be in another unit.

    Raises:
        LogError: if a log cannot be read or resampled, or its time seems to be in milliseconds.
    """
    recorded = read_trials(logs, layout)
    for trial in recorded:
        require_seconds(trial)
    trials = [resample(trial, rate_hz) for trial in recorded]
    warn_of_units(trials)
    return trials


def warn_of_units(trials: Sequence[Trial]) -> None:
    """One line a signal that looks like another unit: nothing else would tell radians from a weak device."""
    for trial in trials:
        for finding in check(trial).findings:
            if finding.topic.startswith("units") and finding.severity is Severity.WARNING:
                text = f"warning: {trial.source}: {finding.topic}: {finding.message}"
                errors.print(text, style="yellow", soft_wrap=True, highlight=False)

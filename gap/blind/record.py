"""Recording a further motion on the device of a case: what follows when a diagnosis asks for one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from hystmpc.trials.csv_files import read_lines, read_table, write_csv
from hystmpc.trials.errors import ConfigError, LogError, did_you_mean
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial

from .core import TRAVEL_MM
from .device import lasts_s
from .scene import RATE_HZ
from .sealed import open_answers

_ANOTHER_SESSION = 7919  # added to the seed of what is random in a device


def record_motion(folder: Path, case: str, motion: Path) -> Path:
    """Run a motion on a case's simulated device and write the log; neither log nor message tells the answer.

    Args:
        folder: of the blind check.
        case: its folder's name.
        motion: CSV with columns `time_s` and `command`.

    Returns:
        The log, in `follow_up/CASE`, numbered on from the trials that the case has.

    Raises:
        ConfigError: on an unknown case, one of real logs, a command beyond the device's travel, or a log that is
            there already.
        LogError: if the motion or the answers cannot be read.
    """
    answers = open_answers(folder)
    if case not in answers:
        raise ConfigError(f"{folder}: no case {case!r}, {did_you_mean(case, answers)}")
    if not answers[case].device or answers[case].suite == "controls":
        raise ConfigError(f"{folder}: case {case} has no device that could move again")
    before = read_trials([folder / "cases" / case])
    clock_s = sum(lasts_s(len(trial)) for trial in before)
    command, log = _command(motion), folder / "follow_up" / case / f"trial_{len(before) + 1:02d}.csv"
    if log.exists():
        raise ConfigError(f"{log}: is recorded already, expected no log there; remove it to record another motion")
    (trial,) = answers[case].blind_device().record([command], len(before), clock_s)
    return write_csv(trial, log)


def record_again(folder: Path, case: str) -> list[Trial]:
    """Another session of a case's motions on its device: other noise, other draws, the same effects.

    Raises:
        ConfigError: on an unknown case, or one without a device.
        LogError: if logs or answers cannot be read.
    """
    answers = open_answers(folder)
    if case not in answers or not answers[case].device or answers[case].suite == "controls":
        raise ConfigError(f"{folder}: case {case!r} has no device that could move again")
    device = answers[case].blind_device()
    commands = [trial.command for trial in read_trials([folder / "cases" / case])]
    return replace(device, seed=device.seed + _ANOTHER_SESSION).record(commands)


def _command(path: Path) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    columns = ("time_s", "command")
    table = read_table(read_lines(path), str(path))
    missing = [name for name in columns if name not in table.numbers]
    if missing:
        raise LogError(f"{path}: missing columns {', '.join(missing)}, expected time_s, command")
    t, command = (np.asarray(table.numbers[name], dtype=np.float64) for name in columns)
    if t.size < 2 or not (np.isfinite(t).all() and np.isfinite(command).all() and np.all(np.diff(t) > 0)):
        raise LogError(f"{path}: expected two or more finite samples with increasing time")
    if command.min() < -1e-6 or command.max() > TRAVEL_MM + 1e-6:
        raise ConfigError(
            f"{path}: command {command.min():.4g} to {command.max():.4g} mm, expected within 0 to {TRAVEL_MM:g}"
        )
    grid = np.arange(round((t[-1] - t[0]) * RATE_HZ) + 1) / RATE_HZ
    return np.clip(np.interp(grid, t - t[0], command), 0.0, TRAVEL_MM)

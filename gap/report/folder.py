"""Folder of a diagnosis: `diagnosis.json`, report, corrected simulator, next motion, and the files of every run."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.simulator import save_simulator
from hystmpc.trials.csv_files import format_table
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.json_text import file_text, plain
from hystmpc.trials.layouts import OUTPUT_COLUMN, command_column
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.trial import Trial

from ..diagnosis import FIXED_FILE, FORMATS, MOTION_FILE, Diagnosis
from ..next.motion_design import write_motion
from .report_data import STAGES, ReportData

DIAGNOSIS_FILE, GIVEN_FILE = "diagnosis.json", "sim.given.yaml"
REPLAY_FOLDER = "replay"
"""Folder with the commands for the user's own simulator, within that of the diagnosis."""

_SOMETIMES = (FIXED_FILE, GIVEN_FILE, MOTION_FILE, "log.mcap")
_GAP_S = 1.0  # between trials in one log


def require_free(folder: Path | str, formats: Sequence[str] = FORMATS) -> None:
    """Refuse a folder that holds anything but an older diagnosis, so that no other files are overwritten.

    Args:
        formats: of the diagnosis that may be there.

    Raises:
        ConfigError: if it is a file, or holds anything but a diagnosis.
    """
    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise ConfigError(f"{path}: is a file, expected a folder")
    if not path.is_dir() or not any(path.iterdir()):
        return
    try:
        RunFolder.open(path)
        free = holds_diagnosis(path, formats)
    except LogError:
        free = False
    if not free:
        raise ConfigError(f"{path}: is not empty and holds no diagnosis, expected a new, empty or diagnosis folder")


def holds_diagnosis(folder: Path, formats: Sequence[str] = FORMATS) -> bool:
    """Whether a folder has the `diagnosis.json` of a diagnosis of one of these formats."""
    try:
        return json.loads((folder / DIAGNOSIS_FILE).read_text(encoding="utf-8")).get("format") in formats
    except (OSError, ValueError, AttributeError):
        return False


def save_diagnosis(
    data: ReportData,
    folder: Path | str,
    settings: Mapping[str, Any],
    *,
    models: Iterable[Path | str] = (),
) -> Path:
    """Write all files of a diagnosis, each completely or not at all; an older diagnosis is replaced.

    Raises:
        ConfigError: if the folder holds something else or cannot be written.
    """
    require_free(folder)
    with renewed(folder, _SOMETIMES) as made:
        _write(data, RunFolder.create(made, settings, seed=data.seed, models=models))
    _write_replays(data.replays, Path(folder) / REPLAY_FOLDER)
    return Path(folder)


@contextmanager
def renewed(folder: Path | str, sometimes: Iterable[str]) -> Iterator[Path]:
    """Give an empty folder whose files are moved to a folder at the end, completely or not at all.

    Args:
        sometimes: names of files that not every diagnosis has; older ones are removed.

    Raises:
        ConfigError: if the folder cannot be written.
    """
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part"))
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written ({error.strerror}), expected a writable folder") from None
    try:
        yield made
        names = sorted(path.name for path in made.iterdir())
        for name in names:
            os.replace(made / name, target / name)
        for name in set(sometimes) - set(names):
            (target / name).unlink(missing_ok=True)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def diagnosis_json(diagnosis: Diagnosis) -> str:
    """The text of `diagnosis.json`; numbers that are not finite are null."""
    return file_text(plain(diagnosis.as_json()), indent=2)


def _write(data: ReportData, run: RunFolder) -> None:
    write_atomically(run.path / DIAGNOSIS_FILE, diagnosis_json(data.diagnosis))
    run.write_log(_log(data))
    for simulator, name in ((data.fixed, FIXED_FILE), (data.nominal, GIVEN_FILE)):
        if simulator is not None:
            save_simulator(simulator, run.path / name)
    if data.proposal is not None:
        write_motion(run.path / MOTION_FILE, data.proposal, data.command_unit, data.unit)
    for name, content in data.files.items():
        write_atomically(run.path / name, content)
    from .page import write_report  # imports matplotlib

    write_report(data, run.path)


def _write_replays(replays: Sequence[Trial], folder: Path) -> None:
    """Write a file of each command, `time_s` and the command, in place of older ones.

    A file with other columns holds the output of the user's simulator, and is left as it is.
    """
    for old in folder.glob("*.csv"):
        if _is_command_alone(old):
            old.unlink()
    for trial in replays:
        folder.mkdir(exist_ok=True)
        columns = {"time_s": np.round(trial.t, 9), command_column(trial.units.command): trial.command}
        if not (folder / trial.source).exists():
            write_atomically(folder / trial.source, format_table(columns))


def _is_command_alone(file: Path) -> bool:
    with file.open(encoding="utf-8", errors="replace") as text:
        time, *others = text.readline().strip().split(",")
    return time == "time_s" and len(others) == 1 and others[0].startswith("command")


def _log(data: ReportData) -> dict[str, Any]:
    starts, at = [], 0.0
    for trial in data.trials:
        starts.append(at - trial.trial.t[0])
        at += trial.trial.duration_s + _GAP_S
    trials = data.trials
    joined = {
        "time_s": [trial.trial.t + start for trial, start in zip(trials, starts, strict=True)],
        command_column(data.command_unit): [trial.trial.command for trial in trials],
        OUTPUT_COLUMN[data.unit]: [trial.trial.angle for trial in trials],
        **{f"{stage}_{data.unit}": [getattr(trial, stage) for trial in trials] for stage in STAGES},
    }
    texts = {
        "trial": [trial.name for trial in trials for _ in range(len(trial.trial))],
        "role": [trial.role for trial in trials for _ in range(len(trial.trial))],
    }
    return {name: np.concatenate(parts) for name, parts in joined.items()} | texts

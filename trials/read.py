"""Reading recorded trials of any format: files and folders, told by their names; data frames; trials in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from .csv_files import Frame, Table, first_row, frame_table, read_csv, read_lines, read_table, split_lines
from .errors import ConfigError, LogError, in_a_line
from .layouts import LogMapping, Preset, get_preset, is_mapping_file, load_mapping
from .mat_ import open_mat
from .mcap_ import open_mcap
from .rosbag_ import is_bag, open_bag
from .signals import Raw, Series, Source, canonical_mapping, missing, read_mapped
from .trial import Trial, even_time, positive_rate
from .uniform import at_rate

Layout = str | Preset | LogMapping
"""A layout's name, a mapping file (`*.yaml`), a `Preset` (tables), a `LogMapping`, or `auto`."""

Log = Path | str | Frame | Trial
"""One recorded trial: a file, the folder of a ROS 2 bag, a data frame, or the trial itself."""

OPENERS: dict[str, Callable[[Path], Source]] = {".mcap": open_mcap, ".db3": open_bag, ".mat": open_mat}
"""Formats of named signals by the ending of the file; every other ending is delimited text."""


@in_a_line
def read_trials(
    logs: Log | Iterable[Log],
    preset: Layout = "auto",
    *,
    rate_hz: float | None = None,
    sampled_hz: float | None = None,
) -> list[Trial]:
    """Read recorded trials of any format, in the order given.

    Args:
        logs: one or several of: delimited text, `.mat`, MCAP, ROS 2 bag, a folder of these, a data frame with the
            columns of the layout (such as `time_s`, `command`, `angle_deg`), a `Trial`.
        preset: layout of all of them: `auto`, `canonical`, `tendon-catheter`, or a mapping file `*.yaml`.
        rate_hz: resample to this rate [Hz] and cut at gaps, see `at_rate`; None leaves the samples as they are.
        sampled_hz: rate [Hz] of logs that were sampled evenly, whose time stamps are not looked at.

    Raises:
        LogError: if nothing is found, or a log cannot be read or resampled; names file, row and what was expected.
        ConfigError: on an unknown preset or a wrong mapping file.
    """
    layout = resolve(preset)
    several = [logs] if isinstance(logs, Path | str | Frame | Trial) else list(logs)
    trials = []
    for log in several or expand_logs([]):  # which refuses to do without any
        files = expand_logs([log]) if isinstance(log, Path | str) else [log]
        trials += [read_log(file, layout, sampled_hz) for file in files]
    trials = _told_apart(trials)
    return trials if rate_hz is None else at_rate(trials, rate_hz)


def _told_apart(trials: list[Trial]) -> list[Trial]:
    """The trials with a number behind each name that stands more than once: results name trials."""
    counts, seen = Counter(trial.source for trial in trials), Counter[str]()
    named = []
    for trial in trials:
        seen[trial.source] += 1
        name = f"{trial.source} {seen[trial.source]}"
        named.append(trial if counts[trial.source] == 1 else replace(trial, source=name))
    return named


def read_log(log: Log, preset: Layout = "auto", sampled_hz: float | None = None) -> Trial:
    """Read one trial; see `read_trials`, which takes folders too.

    Raises:
        LogError: if the log cannot be used; one line with the file, what was got and what is available.
        ConfigError: on an unknown preset or a wrong mapping file, or a preset of another format.
    """
    if isinstance(log, Trial):
        return log if sampled_hz is None else replace(log, t=even_time(len(log), sampled_hz))
    layout = resolve(preset)
    if is_table(log) and not isinstance(layout, LogMapping):
        return read_csv(log, layout, sampled_hz)
    return read_raw(log, layout, sampled_hz).trial()


def expand_logs(paths: Iterable[Path | str]) -> list[Path]:
    """Logs to read: a folder stands for its `*.csv`, or else its logs of other formats, in the order of their names.

    Raises:
        LogError: if nothing is given, or a folder holds no log.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        inside = _logs_in(path) if path.is_dir() else [path]
        if not inside:
            raise LogError(f"{path}: no *.csv (nor *.mcap, *.db3, *.mat) in this folder, expected recorded logs")
        files += inside
    if not files:
        raise LogError("no logs given, expected files or folders of logs")
    return files


def _logs_in(folder: Path) -> list[Path]:
    """The `*.csv` of a folder; without any, its bags, `*.mcap`, `*.db3` and `*.mat`, by name."""
    if is_bag(folder):
        return [folder]
    tables = sorted(folder.glob("*.csv"))
    others = [entry for entry in folder.iterdir() if is_bag(entry) or entry.suffix.lower() in OPENERS]
    return tables or sorted(others)


def read_raw(log: Path | str | Frame, preset: Layout = "auto", sampled_hz: float | None = None) -> Raw:
    """Read a log by its named signals without judging its values.

    Raises:
        LogError: if the log cannot be read, or lacks a signal.
        ConfigError: on an unknown preset or a wrong mapping file, or a preset of another format.
    """
    layout, source = resolve(preset), _open(log)
    if isinstance(layout, LogMapping):
        return read_mapped(source, _sampled(layout, sampled_hz))
    if layout != "auto":
        name = layout.name if isinstance(layout, Preset) else layout
        if name != "canonical":
            raise ConfigError(
                f"{source.path}: preset {name} is for delimited text, expected auto or a mapping file (*.yaml)"
            )
    return read_mapped(source, _sampled(canonical_mapping(source.names(), source.path), sampled_hz))


def _sampled(mapping: LogMapping, sampled_hz: float | None) -> LogMapping:
    """The mapping of a log that was sampled evenly, where its rate is given."""
    return mapping if sampled_hz is None else mapping.model_copy(update={"rate_hz": positive_rate(sampled_hz)})


def resolve(preset: Layout) -> Layout:
    """What `--preset` means: a mapping is read from its file; a name is checked.

    Raises:
        ConfigError: on an unknown preset or a wrong mapping file.
    """
    if not isinstance(preset, str) or preset == "auto":
        return preset
    return load_mapping(preset) if is_mapping_file(preset) else get_preset(preset)


def is_table(log: Path | str | Frame) -> TypeGuard[Path | str | Frame]:
    """Whether a log is delimited text or a data frame."""
    return isinstance(log, Frame) or (Path(log).suffix.lower() not in OPENERS and not is_bag(Path(log)))


def _open(log: Path | str | Frame) -> Source:
    if isinstance(log, Frame):
        return _TableLog(frame_table(log))
    path = Path(log)
    if is_bag(path):
        return open_bag(path)
    opener = OPENERS.get(path.suffix.lower())
    return opener(path) if opener is not None else _TableLog(_guessed_table(path))


def _guessed_table(path: Path) -> Table:
    """Delimited text whose delimiter is not known; columns without a header row are `[0]`, `[1]`, ..."""
    lines, delimiter = split_lines(read_lines(path))
    _, cells = first_row(lines, delimiter)
    unnamed = [f"[{k}]" for k in range(len(cells))] if all(map(_is_number, cells)) else []
    return read_table(lines, str(path), delimiter, unnamed)


class _TableLog:
    """A `Source` over the columns of a table, for mapping files."""

    note = ""

    def __init__(self, table: Table) -> None:
        self.path, self._table = table.source, table

    def names(self) -> tuple[str, ...]:
        return tuple(name for name in self._table.numbers if name)

    def series(self, signals: Iterable[str], time: str) -> list[Series]:
        t = self._column(time) if time not in ("log", "header") else None
        columns = [self._column(signal) for signal in signals]
        return [Series(np.full(y.size, np.nan) if t is None else t, y) for y in columns]

    def _column(self, name: str) -> NDArray[np.float64]:
        if name not in self._table.numbers:
            raise missing(self.path, name, self.names())
        return self._table.numbers[name]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True

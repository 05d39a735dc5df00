"""Reading of recorded trials in any format on one uniform grid: files, folders, data frames, trials in memory."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np

from .command_noise import remove_command_noise
from .csv_files import open_table, read_columns
from .errors import ConfigError, LogError, in_a_line
from .formats import ENDINGS, format_of, is_bag
from .layouts import Layout, LogMapping, is_mapping_file, layout_named, load_mapping
from .signals import (
    Series,
    SignalLog,
    UncheckedLog,
    canonical_mapping,
    filled_rows,
    is_merged,
    merged_note,
    missing,
    read_mapped,
)
from .tables import FrameLike, LogTable
from .trial import Trial, even_time, parts_at_gaps, positive_rate, require_uniform, resample
from .types import Vec

AnyLayout = str | Layout | LogMapping
"""Layout: its name, a mapping file (`*.yaml`), a `Layout` (tables), a `LogMapping`, or `auto`."""

Log = Path | str | FrameLike | Trial
"""One recorded trial: a file, the folder of a ROS 2 bag, a data frame, or the trial itself."""

OPENERS = {
    "mcap": ("mcap_", "open_mcap"),
    "rosbag2": ("mcap_", "open_bag"),
    "rosbag1": ("mcap_", "open_bag1"),
    "mat": ("mat_", "open_mat"),
    "npz": ("arrays", "open_npz"),
    "npy": ("arrays", "open_npz"),
    "tdms": ("arrays", "open_tdms"),
}
"""Formats of named signals, with module and name of the reader, imported at use; other formats are tables."""


@in_a_line
def read_trials(
    logs: Log | Iterable[Log],
    layout: AnyLayout = "auto",
    *,
    rate_hz: float | None = None,
    sampled_hz: float | None = None,
) -> list[Trial]:
    """Read recorded trials of any format, in the order given.

    Args:
        logs: one or several of: delimited text, Excel, LabVIEW, MATLAB, NumPy, MCAP, ROS bag, a folder of these, a data
            frame with the columns of the layout (such as `time_s`, `command`, `angle_deg`), a `Trial`.
        layout: layout of all of them: `auto`, `canonical`, `tendon-catheter`, or a mapping file `*.yaml`.
        rate_hz: resample to this rate [Hz] and cut at gaps, see `at_rate`; None leaves the samples as they are.
        sampled_hz: rate [Hz] of logs that were sampled evenly, whose time stamps are not looked at.

    Raises:
        LogError: if no log exists, or a log cannot be read or resampled; names file, row and the expected value.
        ConfigError: on an unknown layout or a wrong mapping file.
    """
    layout = resolve(layout)
    several = [logs] if isinstance(logs, Path | str | FrameLike | Trial) else list(logs)
    trials = []
    for log in several or expand_logs([]):  # raises an error without any
        files = expand_logs([log]) if isinstance(log, Path | str) else [log]
        trials += [read_log(file, layout, sampled_hz) for file in files]
    counts, seen = Counter(trial.source for trial in trials), Counter[str]()
    for k, trial in enumerate(trials):
        seen[trial.source] += 1
        if counts[trial.source] > 1:
            trials[k] = replace(trial, source=f"{trial.source} {seen[trial.source]}")
    return trials if rate_hz is None else at_rate(trials, rate_hz)


def read_log(log: Log, layout: AnyLayout = "auto", sampled_hz: float | None = None) -> Trial:
    """Read one trial; see `read_trials`, which also accepts folders.

    Raises:
        LogError: if the log cannot be used; one line with the file, the actual and the available signals.
        ConfigError: on an unknown layout or a wrong mapping file, or a layout of another format.
    """
    if isinstance(log, Trial):
        return log if sampled_hz is None else replace(log, t=even_time(len(log), sampled_hz))
    return read_unchecked(log, layout, sampled_hz).trial()


_OTHERS = ", ".join(f"*{ending}" for ending in ENDINGS)


def expand_logs(paths: Iterable[Path | str]) -> list[Path]:
    """Files of the logs to read; a folder stands for its `*.csv`, otherwise for its logs of other formats, by name.

    Raises:
        LogError: if nothing is given, or a folder holds no log.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        inside = _logs_in(path) if path.is_dir() else [path]
        if not inside:
            raise LogError(f"{path}: no *.csv (nor {_OTHERS}) in this folder, expected recorded logs")
        files += inside
    if not files:
        raise LogError("no logs given, expected files or folders of logs")
    return files


def _logs_in(folder: Path) -> list[Path]:
    """The `*.csv` of a folder, otherwise its bags and logs of other formats, by name."""
    if is_bag(folder):
        return [folder]
    entries = sorted(entry for entry in folder.iterdir() if not entry.name.startswith(_NO_LOGS))
    tables = [entry for entry in entries if entry.suffix == ".csv"]
    return tables or [entry for entry in entries if is_bag(entry) or entry.suffix.lower() in ENDINGS]


_NO_LOGS = (".", "~$")  # auxiliary files of macOS and Excel


def read_unchecked(
    log: Path | str | FrameLike, layout: AnyLayout = "auto", sampled_hz: float | None = None
) -> UncheckedLog:
    """Read a log without any check of its values.

    Raises:
        LogError: if the log cannot be read, or lacks a signal.
        ConfigError: on an unknown layout or a wrong mapping file, or a layout of another format.
    """
    layout = resolve(layout)
    if isinstance(layout, LogMapping):
        names = (name for signal in layout.signals() for name in (signal.signal, signal.second or signal.signal))
        return _read_mapped(_open(log, (layout.time, *names)), layout, sampled_hz)
    if _is_table(log):
        return read_columns(log, layout, sampled_hz)
    source = _open(log, ())
    if layout != "auto":
        name = layout.name if isinstance(layout, Layout) else layout
        if name != "canonical":
            raise ConfigError(
                f"{source.path}: layout {name} is for delimited text, expected auto or a mapping file (*.yaml)"
            )
    try:
        mapping = canonical_mapping(source.names(), source.path, source.clock)
    except LogError as error:
        raise source.not_read() or error from None
    return _read_mapped(source, mapping, sampled_hz)


def _read_mapped(source: SignalLog, mapping: LogMapping, sampled_hz: float | None) -> UncheckedLog:
    changes: dict[str, object] = {"time_unit": "s"} if mapping.time in source.times else {}  # a date has no other
    changes |= {} if sampled_hz is None else {"rate_hz": positive_rate(sampled_hz)}
    return read_mapped(source, mapping.model_copy(update=changes))


def resolve(layout: AnyLayout) -> AnyLayout:
    """Resolve `--layout`: read a mapping from its file, or check a name."""
    layout = str(layout) if isinstance(layout, Path) else layout
    if not isinstance(layout, str) or layout == "auto":
        return layout
    return load_mapping(layout) if is_mapping_file(layout) else layout_named(layout)


def _is_table(log: Path | str | FrameLike) -> bool:
    return isinstance(log, FrameLike) or not (is_bag(Path(log)) or format_of(Path(log)) in OPENERS)


def _open(log: Path | str | FrameLike, wanted: Iterable[str]) -> SignalLog:
    if isinstance(log, FrameLike) or _is_table(log):
        return _TableLog(open_table(log, wanted))
    path = Path(log)
    module, name = OPENERS["rosbag2" if is_bag(path) else format_of(path)]
    source: SignalLog = getattr(import_module(f".{module}", __package__), name)(path)
    return source


class _TableLog(SignalLog):
    def __init__(self, table: LogTable) -> None:
        self.path, self.table, self.note, self.times = table.source, table, "", table.times

    def names(self) -> tuple[str, ...]:
        return tuple(name for name in self.table.numbers if name)

    def series(self, signals: Sequence[str], time: str) -> list[Series]:
        self.note = self.table.left_out((*signals, time))
        t = self._column(time) if time not in ("log", "header") else None
        columns = [self._column(signal) for signal in signals]
        if t is None:
            return [Series(np.full(y.size, np.nan), y) for y in columns]
        command, angle, *_ = columns
        if is_merged(command, angle):
            self.note = "; ".join(filter(None, (merged_note(command, angle), self.note)))
            return [filled_rows(t, y) for y in columns]
        return [Series(t, y) for y in columns]

    def _column(self, name: str) -> Vec:
        if name in self.table.faults:
            raise self.table.not_numbers(name)
        if name not in self.table.numbers:
            place = int(name[1:-1]) if _PLACE.fullmatch(name) else -1
            if 0 <= place < len(self.table.header) and self.table.header[place] in self.table.numbers:
                return self.table.numbers[self.table.header[place]]
            if name in self.table.texts:
                raise self.table.not_numbers(name)
            raise missing(self.path, name, self.names())
        return self.table.numbers[name]


_PLACE = re.compile(r"\[\d{1,4}\]")  # a column by its place, also of a table whose columns have names


def at_rate(trials: Iterable[Trial], rate_hz: float) -> list[Trial]:
    """Cut trials at their gaps, remove the noise of a measured command, and resample them to a uniform grid."""
    parts = remove_command_noise([part for trial in trials for part in parts_at_gaps(trial)])
    for k, part in enumerate(parts):
        even = False
        with suppress(LogError):
            even = bool(np.isclose(require_uniform(part) * rate_hz, 1.0, rtol=1e-9))
        parts[k] = part if even else resample(part, rate_hz)
    return parts

"""Recording of a run folder by a thread."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any, Protocol, final

from hystmpc.trials import mcap_
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.layouts import COMMAND_UNITS
from hystmpc.trials.run_folder import RunFolder

from .csv_log import CsvLog
from .sample import Sample, ThreadedSink

FLUSH_S = 0.5
"""Time between flushes [s]: what a kill may cost at most, beside what was waiting."""

_DRAIN_S = 0.02  # little and often: in a long turn the control thread would wait for the interpreter's lock
_CLOSE_S = 10.0

Tell = Callable[[str], None]
_logger = logging.getLogger(__name__)


class _Log(Protocol):
    def add(self, sample: Sample) -> None: ...
    def flush(self) -> None: ...
    def close(self) -> None: ...


@dataclass(frozen=True)
class RecordingMeta:
    """Metadata of a run folder.

    Attributes:
        unit: of the command.
        seed: of the run's random numbers, None where it draws none.
        models: model files of the run; their SHA-256 is kept.
        command_line: how the run was started; the process's own where None.
        stages: names of the stages that get a column in log.csv; the first sample's where empty.

    Raises:
        ConfigError: on a unit that a log cannot name.
    """

    unit: str
    seed: int | None = None
    models: tuple[Path, ...] = ()
    command_line: tuple[str, ...] | None = None
    stages: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.unit not in COMMAND_UNITS:
            raise ConfigError(f"recording: got a command in {self.unit!r}, expected {', '.join(COMMAND_UNITS)}")


def create_folder(folder: Path | str, config: Settings | Mapping[str, Any], meta: RecordingMeta) -> RunFolder:
    """The run folder of a recording, with config.yaml and meta.json.

    Raises:
        ConfigError: if the folder is not new or empty or cannot be made, or a model file is missing.
    """
    return RunFolder.create(folder, config, seed=meta.seed, models=meta.models, command_line=meta.command_line)


def open_recording(
    folder: Path | str,
    config: Settings | Mapping[str, Any],
    meta: RecordingMeta,
    rate_hz: float,
    tell: Tell | None = None,
    report: bool = True,
) -> Recording:
    """Start a recording by a thread of this process.

    For fast loops see `open_recorder_process`, whose process leaves the interpreter to the control thread.

    Args:
        folder: a new or empty folder.
        config: resolved settings of the run.
        meta: what else the folder says.
        rate_hz: rate of the loop [Hz].
        tell: takes one line when recording has to stop; a warning of the `logging` module where None.
        report: whether to write report.html at the end.

    Raises:
        ConfigError: on a folder that is not new or empty, or cannot be written, or a missing model file.
    """
    return Recording(create_folder(folder, config, meta), meta, rate_hz, tell, report=report)


@final
class Recording(ThreadedSink):
    """Writes log.csv and, where `mcap` is installed, log.mcap of a run folder; report.html at the end.

    Every 0.5 s whole rows and a whole chunk go to the disk. When the disk is full or fails, recording ends, the files
    keep what was flushed, the user is told once, and the run goes on.

    Args:
        tell: see `open_recording`.
        flushed: called after every flush with the number of samples on the disk.

    Raises:
        ConfigError: if the logs cannot be made.
    """

    def __init__(
        self,
        run: RunFolder,
        meta: RecordingMeta,
        rate_hz: float,
        tell: Tell | None = None,
        flushed: Callable[[int], None] | None = None,
        report: bool = True,
    ) -> None:
        if not rate_hz > 0:
            raise ConfigError(f"recording: got a rate of {rate_hz} Hz, expected a positive number")
        super().__init__("hystmpc-recording", rate_hz, _DRAIN_S)
        self.run = run
        self._tell = tell or _logger.warning
        self._wants_report = report
        self._on_flush = flushed or (lambda count: None)
        try:
            self._logs = _open_logs(run.path, meta)
        except OSError as error:
            raise ConfigError(f"{run.path}: log cannot be written ({error.strerror or error})") from None
        self._written = self._on_disk = self.unwritable = 0
        self._due_s = monotonic()
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Samples that were not recorded: the queue was full, recording had ended, or they could not be written."""
        return super().dropped + self.unwritable

    @property
    def on_disk(self) -> int:
        """Samples on the disk, which a kill of this process cannot lose."""
        return self._on_disk

    def close(self) -> None:
        """Write the remaining samples, the summary and the report, once; failures are reported, not raised."""
        if not self._finish(_CLOSE_S):
            return
        if self._thread.is_alive():
            self._tell(f"{self.run.path}: the disk did not take the log within {_CLOSE_S:g} s; its end is missing")
            return
        if self.dropped:
            self._tell(f"{self.run.path}: {self.dropped} samples are not in the log")
        if self._on_disk and self._wants_report:
            self._report()

    def _turn(self, samples: list[Sample], ending: bool) -> bool:
        """Add to the logs, and flush when it is time."""
        try:
            self._add(samples)
            now = monotonic()
            if self._written > self._on_disk and (now >= self._due_s or ending):
                self._flush()
                self._due_s = now + FLUSH_S
            if ending:
                for log in self._logs:
                    log.close()
        except OSError as error:
            self._stop(error)
        return not self.problem

    def _add(self, samples: list[Sample]) -> None:
        for sample in samples:
            try:
                for log in self._logs:
                    log.add(sample)
                self._written += 1
            except (ArithmeticError, AttributeError, TypeError, ValueError):  # of wrong types; ends no recording
                self.unwritable += 1

    def _flush(self) -> None:
        for log in self._logs:
            log.flush()
        self._on_disk = self._written
        self._on_flush(self._on_disk)

    def _stop(self, error: OSError) -> None:
        """Recording is over; the run is not."""
        self._waiting.closed = True
        self.unwritable += len(self._waiting.take()) + self._written - self._on_disk
        self.problem = (
            f"{self.run.path}: recording has stopped ({error.strerror or error}); "
            f"{self._on_disk} samples are on the disk; the run goes on"
        )
        for log in self._logs:
            try:
                log.close()
            except OSError:  # what was flushed is on the disk; there is nothing left to save
                continue
        self._tell(self.problem)

    def _report(self) -> None:
        from .report import write_report

        try:
            write_report(self.run, dropped=self.dropped, problem=self.problem)
        except Exception as error:  # noqa: BLE001 - the run is over and its log safe: a drawing must not look like a fault
            self._tell(f"{self.run.path}: no report.html ({' '.join(str(error).split())})")


def _open_logs(folder: Path, meta: RecordingMeta) -> tuple[_Log, ...]:
    command = f"command_{meta.unit}"
    logs: list[_Log] = [CsvLog(folder / "log.csv", command, meta.stages)]
    if mcap_.available():
        from .mcap_log_ import McapLog

        logs.append(McapLog(folder / "log.mcap", command))
    return tuple(logs)

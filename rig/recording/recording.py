"""Recording of a run folder by a thread: log.csv, and log.mcap for Foxglove and PlotJuggler."""

from __future__ import annotations

import csv
import io
import json
import logging
import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import IO, Any, Protocol, cast, final

from hystmpc.trials import mcap_
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.json_text import plain
from hystmpc.trials.layouts import COMMAND_UNITS, command_column
from hystmpc.trials.run_folder import RunFolder

from ..axes import columns
from .sample import TAKEN, Sample, ThreadedSink

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

    Raises:
        ConfigError: on a unit that a log cannot name.
    """

    unit: str  # of the command
    seed: int | None = None  # of the run's random numbers, None without any
    models: tuple[Path, ...] = ()  # model files of the run; their SHA-256 is recorded
    command_line: tuple[str, ...] | None = None  # that started the run; the process's own where None
    stages: tuple[str, ...] = ()  # names of the stages with a column in log.csv; the first sample's where empty
    axes: int = 1  # number of commands and of angles
    inputs: tuple[str, ...] = ()  # names of measured inputs, which have a column each

    def __post_init__(self) -> None:
        if self.unit not in COMMAND_UNITS:
            raise ConfigError(f"recording: got a command in {self.unit!r}, expected {', '.join(COMMAND_UNITS)}")


def create_folder(folder: Path | str, config: Settings | Mapping[str, Any], meta: RecordingMeta) -> RunFolder:
    """Create the run folder of a recording, with config.yaml and meta.json."""
    return RunFolder.create(folder, config, seed=meta.seed, models=meta.models, command_line=meta.command_line)


def open_recording(
    folder: Path | str,
    config: Settings | Mapping[str, Any],
    meta: RecordingMeta,
    rate_hz: float,
    tell: Tell | None = None,
    report: bool = True,
) -> Recording:
    """Start a recording in a thread of this process.

    For fast loops see `open_recorder_process`, whose process leaves the interpreter to the control thread.

    Args:
        rate_hz: rate of the loop [Hz].
        tell: called with one line when recording has to stop; a warning of the `logging` module where None.
        report: whether to write report.html at the end.

    Raises:
        ConfigError: on a folder that is not new or empty, or cannot be written, or a missing model file.
    """
    return Recording(create_folder(folder, config, meta), meta, rate_hz, tell, report=report)


@final
class Recording(ThreadedSink):
    """Recorder of log.csv, log.mcap (if `mcap` is installed) and finally report.html of a run folder.

    Every 0.5 s whole rows and a whole chunk go to the disk. When the disk is full or fails, recording ends, the files
    keep the flushed samples, the user gets one message, and the run continues.

    Args:
        flushed: called after every flush with the number of samples on the disk.

    Raises:
        ConfigError: if the logs cannot be created.
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
        self._written = self.unwritable = 0
        self.on_disk = 0  # samples that are safe from a kill of this process
        self._due_s = monotonic()
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of samples not recorded: queue full, recording ended, or samples not writable."""
        return super().dropped + self.unwritable

    def close(self) -> None:
        """Write the remaining samples, the summary and the report, once; failures are reported, not raised."""
        if not self._finish(_CLOSE_S):
            return
        if self._thread.is_alive():
            self._tell(f"{self.run.path}: the disk did not take the log within {_CLOSE_S:g} s; its end is missing")
            return
        if self.dropped:
            self._tell(f"{self.run.path}: {self.dropped} samples are not in the log")
        if self.on_disk and self._wants_report:
            self._report()

    def _turn(self, samples: list[Sample], ending: bool) -> bool:
        try:
            self._add(samples)
            now = monotonic()
            if self._written > self.on_disk and (now >= self._due_s or ending):
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
        self.on_disk = self._written
        self._on_flush(self.on_disk)

    def _stop(self, error: OSError) -> None:
        """End the recording without an effect on the run."""
        self._waiting.closed = True
        self.unwritable += len(self._waiting.take()) + self._written - self.on_disk
        self.problem = (
            f"{self.run.path}: recording has stopped ({error.strerror or error}); "
            f"{self.on_disk} samples are on the disk; the run goes on"
        )
        for log in self._logs:
            with suppress(OSError):  # what was flushed is on the disk; there is nothing left to save
                log.close()
        self._tell(self.problem)

    def _report(self) -> None:
        from .report import write_report

        try:
            write_report(self.run, dropped=self.dropped, problem=self.problem)
        except Exception as error:  # noqa: BLE001 - the run is over and its log safe: a drawing must not look like a fault
            self._tell(f"{self.run.path}: no report.html ({' '.join(str(error).split())})")


def _open_logs(folder: Path, meta: RecordingMeta) -> tuple[_Log, ...]:
    command = f"command_{meta.unit}" if meta.axes == 1 else command_column(meta.unit)
    logs: list[_Log] = [CsvLog(folder / "log.csv", command, meta.stages)]
    if mcap_.available():
        logs.append(McapLog(folder / "log.mcap", command, meta.axes, meta.inputs))
    return tuple(logs)


@final
class CsvLog:
    """Writer of log.csv in canonical columns, followed by the remaining fields of a sample.

    The last column is one character wide: a row that was cut off by a kill lacks it, and readers leave that row out.

    Args:
        command: name of the command's column, such as `command_mm`.
        stages: names of the stages with a column; the first sample's where empty.

    Raises:
        OSError: if the file cannot be created, or the disk is full or fails.
    """

    def __init__(self, path: Path, command: str, stages: tuple[str, ...]) -> None:
        self._file = GrowingFile(path)
        self._command = command
        self._stages = stages
        self._text = io.StringIO()
        self._rows = csv.writer(self._text, lineterminator="\n")
        self._begun = False

    def add(self, sample: Sample) -> None:
        """Append one row in memory; stages without a column are left to the MCAP log."""
        if not self._begun:
            self._begin(sample)
        spent = dict(sample.stages_s)
        s = sample
        numbers = *s.motion(self._command).values(), s.period_s, s.lateness_s
        stages = (repr(float(spent[name])) if name in spent else "" for name in self._stages)
        texts = _cell(s.source), _cell(s.status), _cell(" ".join(s.faults))
        counts = int(s.sequence), int(s.wall_ns)
        self._rows.writerow((*(repr(float(x)) for x in numbers), *counts, *stages, *texts, int(bool(s.missed))))

    def flush(self) -> None:
        """Write whole rows to the disk."""
        self._file.write(self._text.getvalue().encode("utf-8", errors="replace"))
        self._text.seek(0)
        self._text.truncate()
        self._file.commit()

    def close(self) -> None:
        """Write the last rows and close the file."""
        self._file.close()

    def _begin(self, first: Sample) -> None:
        self._begun = True
        self._stages = self._stages or tuple(name for name, _ in first.stages_s)
        numbers = (*first.motion(self._command), "period_s", "lateness_s", "sequence", "wall_ns")
        self._rows.writerow((*numbers, *map(stage_column, self._stages), "source", "status", "faults", "missed"))


@final
class GrowingFile:
    """File that appends the bytes collected in memory at every `commit`.

    After a commit the operating system holds the data: it survives the death of the process (kill -9), though not a
    power cut until the system writes it out or `close` does.

    Raises:
        OSError: if the file exists or cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("xb", buffering=0)
        self._pending = bytearray()
        self._committed = 0

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Append bytes in memory."""
        self._pending += data
        return len(data)

    def tell(self) -> int:
        """Length of the file after the next commit."""
        return self._committed + len(self._pending)

    def flush(self) -> None:
        """No effect: only `commit` writes, so that no writer of a format can leave half a record on the disk."""

    def commit(self) -> None:
        """Append the bytes in memory; if the disk fails (OSError), the file ends with the last commit."""
        rest = memoryview(bytes(self._pending))
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError:
            os.ftruncate(self._file.fileno(), self._committed)
            self._file.seek(self._committed)
            raise
        self._committed += len(self._pending)
        self._pending.clear()

    def close(self) -> None:
        """Write all commits to the disk; uncommitted bytes are lost."""
        try:
            os.fsync(self._file.fileno())
        finally:
            self._file.close()


def stage_column(name: str) -> str:
    """Column of a stage's duration [s]."""
    return f"stage_{name.replace(' ', '_')}_s"


def one_line(text: str) -> str:
    """Text without line breaks and control characters, so that a row stays on one line."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in str(text)).split())


def _cell(text: str) -> str:
    """Text that no reader mistakes for a number or a missing value, since a column's first cell determines its type."""
    line = one_line(text)
    try:
        float(line)
    except ValueError:
        return line or "-"
    return f"({line})"


TIP, TIMING, EVENTS = "/tip", "/timing", "/events"
_INFO, _WARNING, _ERROR = 2, 3, 4  # levels of foxglove.Log
_CHUNK_BYTES = 1 << 22  # a chunk ends with a flush, long before this


@final
class McapLog:
    """Writer of log.mcap: `/tip` (time, command, angles) and `/timing` of every sample, `/events` on changes.

    Messages are stamped with the wall clock of the first sample plus the monotonic time since then, so that a clock
    that jumps does not tear the plot; the wall clock itself is the publish time.

    Args:
        command: name of the command's field, such as `command_mm`.
        axes: number of commands and of angles.
        inputs: names of measured inputs.

    Raises:
        OSError: if the file cannot be created, or the disk is full or fails.
    """

    def __init__(self, path: Path, command: str, axes: int = 1, inputs: Sequence[str] = ()) -> None:
        from mcap.writer import Writer  # an extra

        self._file = GrowingFile(path)
        self._command = command
        self._writer: Any = Writer(cast(IO[bytes], self._file), chunk_size=_CHUNK_BYTES)
        self._writer.start(profile="", library="hystmpc")
        pairs = [columns(name, math.nan, axes) for name in (command, "angle_deg", "reference_deg", "predicted_deg")]
        tip = ("time_s", *pairs[0], *pairs[1], TAKEN, *pairs[2], *pairs[3], *inputs)
        self._tip = self._channel(TIP, "hystmpc.Tip", {name: ["number", "null"] for name in tip})
        timing = {"period_s": ["number", "null"], "lateness_s": ["number", "null"], "missed": ["boolean"]}
        self._timing = self._channel(TIMING, "hystmpc.Timing", timing)
        self._events = self._channel(EVENTS, "foxglove.Log", _LOG_FIELDS)
        self._start_ns: int | None = None
        self._before: tuple[str, tuple[str, ...]] | None = None

    def add(self, sample: Sample) -> None:
        """Append the messages of one sample in memory."""
        elapsed = round(1e9 * sample.t_s)
        if self._start_ns is None:
            self._start_ns = max(int(sample.wall_ns) - elapsed, 0)
        stamp = max(self._start_ns + elapsed, 0)
        self._put(self._tip, stamp, sample, sample.motion(self._command))
        timing = {"period_s": sample.period_s, "lateness_s": sample.lateness_s, "missed": bool(sample.missed)}
        timing |= {stage_column(name): spent for name, spent in sample.stages_s}
        self._put(self._timing, stamp, sample, timing)
        now = sample.source, tuple(sample.faults)
        if now != self._before or sample.missed:
            self._before = now
            self._put(self._events, stamp, sample, _event(sample, stamp))

    def flush(self) -> None:
        """End the chunk and write it to the disk."""
        self._writer.flush()
        self._file.commit()

    def close(self) -> None:
        """Write the summary and close the file."""
        try:
            self._writer.finish()
            self._file.commit()
        finally:
            self._file.close()

    def _channel(self, topic: str, name: str, fields: dict[str, Any]) -> int:
        properties = {field: kind if isinstance(kind, dict) else {"type": kind} for field, kind in fields.items()}
        text = json.dumps({"title": name, "type": "object", "properties": properties})
        schema = self._writer.register_schema(name, "jsonschema", text.encode())
        return self._writer.register_channel(topic, "json", schema)

    def _put(self, channel: int, stamp: int, sample: Sample, message: dict[str, Any]) -> None:
        data = json.dumps(plain(message), allow_nan=False).encode()
        publish = min(max(int(sample.wall_ns), 0), (1 << 64) - 1)
        self._writer.add_message(channel, stamp, data, publish, int(sample.sequence) & 0xFFFFFFFF)


_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_LOG_FIELDS = {
    "timestamp": _TIME,
    "level": ["integer"],
    "message": ["string"],
    "name": ["string"],
    "file": ["string"],
    "line": ["integer"],
    "faults": {"type": "array", "items": {"type": "string"}},
}


def _event(sample: Sample, stamp: int) -> dict[str, Any]:
    text = ": ".join(part for part in (one_line(sample.source), one_line(sample.status)) if part)
    faults = [one_line(fault) for fault in sample.faults]
    parts = [text, f"faults: {', '.join(faults)}" if faults else "", "deadline missed" if sample.missed else ""]
    level = _ERROR if sample.source == "stop" else _WARNING if faults or sample.missed else _INFO
    return {
        "timestamp": {"sec": stamp // 1_000_000_000, "nsec": stamp % 1_000_000_000},
        "level": level,
        "message": "; ".join(part for part in parts if part),
        "name": "hystmpc",
        "file": "",
        "line": 0,
        "faults": faults,
    }
